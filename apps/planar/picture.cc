#include "apps/planar/picture.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

#include "apps/video_writer.h"
#include "dfr/control/rollout.h"
#include "dfr/core/format.h"
#include "dfr/sim/planar/corridor.h"
#include "dfr/sim/planar/disc_push.h"

namespace dfr::apps::planar {
namespace {

constexpr int kWidth = 1100;
constexpr int kCaption = 32;
constexpr int kGrid = 6;  // pixels per cell of the level sets

const cv::Scalar kInk(60, 60, 60);
const cv::Scalar kRed(80, 80, 220);
const cv::Scalar kDemonstration(200, 190, 180);
const cv::Scalar kWay(160, 80, 20);
const cv::Scalar kRecovery(30, 140, 240);

class Recorder final : public control::RolloutObserver {
 public:
  explicit Recorder(Episode& episode) : episode_(&episode) {}
  void OnControl(const control::RolloutEvent& event) override {
    episode_->shots.push_back(
        {{event.x.begin(), event.x.end()}, {event.u.begin(), event.u.end()}, event.step});
    last_.assign(event.next_x.begin(), event.next_x.end());
  }
  void OnStart(std::span<const double> x) override { last_.assign(x.begin(), x.end()); }
  void OnEnd(const control::RolloutResult& result) override {
    episode_->shots.push_back({last_, {}, result.last_step});
    episode_->outcome = result.outcome;
    if (result.outcome == core::Outcome::kHalted) {
      episode_->cause = control::Name(result.halt_cause);
    }
  }

 private:
  Episode* episode_;
  std::vector<double> last_;
};

}  // namespace

std::vector<Episode> Record(const Task& task, const Methods& methods,
                            const std::vector<std::string>& names, std::uint64_t start_seed) {
  std::vector<Episode> episodes;
  for (const std::string& name : names) {
    Episode episode;
    episode.method = name;
    const auto plant = task.plant->Clone();
    const auto controller = methods.Make(name, *plant);
    Recorder recorder(episode);
    control::Rollout(*plant, *controller, {.plant_seed = start_seed, .controller_seed = start_seed},
                     &recorder);
    episodes.push_back(std::move(episode));
  }
  return episodes;
}

View ViewOf(const Task& task) {
  if (const auto* corridor = dynamic_cast<const sim::CorridorPlant*>(task.plant.get())) {
    const auto& o = corridor->options();
    const double top = o.amplitude + 1.5 * o.half_width;
    return {-0.3, o.length + 0.3, -top, top};
  }
  const auto& o = dynamic_cast<const sim::DiscPushPlant&>(*task.plant).options();
  const double top = o.gate_y + 0.04;
  return {-0.05, o.goal_x + 0.08, -top, top};
}

double Reach(const Task& task, std::span<const double> control) {
  double norm = 0.0;
  for (const double u : control) norm = std::hypot(norm, u);
  if (const auto* corridor = dynamic_cast<const sim::CorridorPlant*>(task.plant.get())) {
    return corridor->options().gain * norm;
  }
  const auto& o = dynamic_cast<const sim::DiscPushPlant&>(*task.plant).options();
  return o.pusher_radius + o.step * norm;
}

Painter::Painter(const Task& task, const Methods& methods)
    : task_(&task), methods_(&methods), view_(ViewOf(task)) {
  const auto* corridor = dynamic_cast<const sim::CorridorPlant*>(task.plant.get());
  scale_ = kWidth / (view_.right - view_.left);
  width_ = kWidth;
  height_ = static_cast<int>(scale_ * (view_.top - view_.bottom)) / 2 * 2 + kCaption;

  background_.assign(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_) * 3, 255);
  cv::Mat image(height_, width_, CV_8UC3, background_.data());
  const auto at = [&](double x, double y) {
    return cv::Point(static_cast<int>(scale_ * (x - view_.left)),
                     kCaption + static_cast<int>(scale_ * (view_.top - y)));
  };
  if (corridor != nullptr) {
    for (int row = kCaption; row < height_; ++row) {
      for (int col = 0; col < width_; ++col) {
        const double x = view_.left + col / scale_;
        const double y = view_.top - (row - kCaption) / scale_;
        if (corridor->Clearance(x, y) < 0.0) image.at<cv::Vec3b>(row, col) = {190, 190, 245};
      }
    }
    cv::line(image, at(corridor->options().length, view_.bottom),
             at(corridor->options().length, view_.top), cv::Scalar(80, 180, 80), 2);
  } else {
    const auto& o = dynamic_cast<const sim::DiscPushPlant&>(*task.plant).options();
    for (const double side : {-1.0, 1.0}) {
      cv::circle(image, at(o.gate_x, side * o.gate_y), static_cast<int>(scale_ * o.red_radius),
                 kRed, cv::FILLED, cv::LINE_AA);
    }
    cv::circle(image, at(o.goal_x, 0.0), static_cast<int>(scale_ * o.goal_radius),
               cv::Scalar(80, 180, 80), 2, cv::LINE_AA);
  }
  const Eigen::Index first = corridor != nullptr ? 0 : 2;
  for (const core::Trajectory& d : methods.demonstrations()) {
    for (Eigen::Index t = 0; t + 1 < d.states.rows(); ++t) {
      cv::line(image, at(d.states(t, first), d.states(t, first + 1)),
               at(d.states(t + 1, first), d.states(t + 1, first + 1)), kDemonstration, 1,
               cv::LINE_AA);
    }
  }
}

std::vector<std::uint8_t> Painter::Draw(const Episode& episode, int frame) const {
  std::vector<std::uint8_t> pixels = background_;
  cv::Mat image(height_, width_, CV_8UC3, pixels.data());
  const auto at = [&](double x, double y) {
    return cv::Point(static_cast<int>(scale_ * (x - view_.left)),
                     kCaption + static_cast<int>(scale_ * (view_.top - y)));
  };
  const int last = static_cast<int>(episode.shots.size()) - 1;
  const int now = std::clamp(frame, 0, last);
  const Shot& shot = episode.shots[static_cast<std::size_t>(now)];

  // Level sets: the darker, the deeper inside; white lines between levels, a dark one at g = 0.
  const int rows = (height_ - kCaption) / kGrid + 1;
  const int cols = width_ / kGrid + 1;
  cv::Mat levels(rows, cols, CV_32F);
  double largest = 1e-9;
  std::vector<double> state = shot.x;
  const SupportKind support = SupportOf(episode.method);
  for (int i = 0; i < rows; ++i) {
    for (int j = 0; j < cols; ++j) {
      state[state.size() - 2] = view_.left + j * kGrid / scale_;
      state[state.size() - 1] = view_.top - i * kGrid / scale_;
      const double l = methods_->Level(support, shot.step.t, state);
      levels.at<float>(i, j) = static_cast<float>(std::max(l, -1.0));
      largest = std::max(largest, l);
    }
  }
  cv::Mat fine;
  cv::resize(levels, fine, cv::Size(cols * kGrid, rows * kGrid), 0, 0, cv::INTER_LINEAR);
  const auto band = [&](int i, int j) {
    const double l = fine.at<float>(i, j);
    return l < 0.0 ? 0 : 1 + static_cast<int>(3.999 * std::min(1.0, l / largest));
  };
  for (int i = 0; i + 1 < std::min(fine.rows, height_ - kCaption); ++i) {
    for (int j = 0; j + 1 < std::min(fine.cols, width_); ++j) {
      const int here = band(i, j);
      const bool edge = here != band(i + 1, j) || here != band(i, j + 1);
      auto& pixel = image.at<cv::Vec3b>(i + kCaption, j);
      if (here > 0) {
        const double share = 0.12 + 0.1 * here;
        pixel = {static_cast<std::uint8_t>((1 - share) * pixel[0] + share * 150),
                 static_cast<std::uint8_t>((1 - share) * pixel[1] + share * 160),
                 static_cast<std::uint8_t>((1 - share) * pixel[2] + share * 60)};
      }
      if (edge && std::min({here, band(i + 1, j), band(i, j + 1)}) == 0) {
        pixel = {70, 90, 20};
      } else if (edge) {
        pixel = {235, 240, 225};
      }
    }
  }

  const bool push = shot.x.size() == 4;
  for (int k = 0; k < now; ++k) {
    const Shot& from = episode.shots[static_cast<std::size_t>(k)];
    const Shot& to = episode.shots[static_cast<std::size_t>(k) + 1];
    const bool learned = from.step.mode == control::Mode::kPolicy && !from.step.filtered;
    for (std::size_t block = 0; block < from.x.size(); block += 2) {
      cv::line(image, at(from.x[block], from.x[block + 1]), at(to.x[block], to.x[block + 1]),
               learned ? kWay : kRecovery, 2, cv::LINE_AA);
    }
  }
  const double reach = shot.u.empty() ? 0.0 : Reach(*task_, shot.u);
  if (push) {
    const auto& o = dynamic_cast<const sim::DiscPushPlant&>(*task_->plant).options();
    cv::circle(image, at(shot.x[2], shot.x[3]), static_cast<int>(scale_ * o.object_radius), kInk, 2,
               cv::LINE_AA);
    cv::circle(image, at(shot.x[0], shot.x[1]), static_cast<int>(scale_ * o.pusher_radius), kInk,
               cv::FILLED, cv::LINE_AA);
  } else {
    cv::circle(image, at(shot.x[0], shot.x[1]), 6, kInk, cv::FILLED, cv::LINE_AA);
  }
  if (reach > 0.0) {
    cv::circle(image, at(shot.x[0], shot.x[1]), static_cast<int>(scale_ * reach), kRecovery, 2,
               cv::LINE_AA);
  }
  std::string what = control::Name(shot.step.mode);
  if (shot.step.filtered) what = "filtered policy";
  if (now == last) {
    what = std::string(core::Name(episode.outcome)) +
           (episode.cause.empty() ? "" : ": " + episode.cause);
  }
  const std::string caption = core::Format("%s   control %d   t = %d   %s", episode.method.c_str(),
                                           now, shot.step.t, what.c_str());
  cv::rectangle(image, cv::Rect(0, 0, width_, kCaption), cv::Scalar(240, 242, 243), cv::FILLED);
  cv::putText(image, caption, cv::Point(10, 22), cv::FONT_HERSHEY_SIMPLEX, 0.6, kInk, 1,
              cv::LINE_AA);
  return pixels;
}

void Painter::WritePng(const Episode& episode, std::span<const int> frames,
                       const std::filesystem::path& path) const {
  const int count = static_cast<int>(frames.size());
  cv::Mat all(count * height_, width_, CV_8UC3);
  for (int i = 0; i < count; ++i) {
    std::vector<std::uint8_t> pixels = Draw(episode, frames[static_cast<std::size_t>(i)]);
    cv::Mat(height_, width_, CV_8UC3, pixels.data())
        .copyTo(all.rowRange(i * height_, (i + 1) * height_));
  }
  if (!cv::imwrite(path.string(), all)) {
    throw std::runtime_error(path.string() + ": the picture cannot be written");
  }
}

void Painter::WriteVideo(const std::vector<Episode>& episodes,
                         const std::filesystem::path& path) const {
  const int count = static_cast<int>(episodes.size());
  VideoWriter video(path, cv::Size(width_, count * height_), 12.0);
  std::size_t frames = 0;
  for (const Episode& e : episodes) frames = std::max(frames, e.shots.size());
  // DFR may need thousands of controls: the video then skips some.
  constexpr std::size_t kMostFrames = 240;
  const std::size_t stride = frames / kMostFrames + 1;
  for (std::size_t frame = 0; frame < frames + stride; frame += stride) {
    cv::Mat all(count * height_, width_, CV_8UC3);
    for (int i = 0; i < count; ++i) {
      std::vector<std::uint8_t> pixels =
          Draw(episodes[static_cast<std::size_t>(i)], static_cast<int>(frame));
      cv::Mat(height_, width_, CV_8UC3, pixels.data())
          .copyTo(all.rowRange(i * height_, (i + 1) * height_));
    }
    video.Write(all);
  }
}

}  // namespace dfr::apps::planar
