#include "apps/study/planar/picture.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

#include "apps/video_writer.h"
#include "dfr/core/text/format.h"
#include "dfr/sim/gallery/corridor.h"
#include "dfr/sim/gallery/disc_push.h"

namespace dfr::study::planar {
namespace {

constexpr int kWidth = 1100;
constexpr int kNarrow = 640;  // without supports
constexpr int kCaption = 32;
constexpr int kGrid = 6;  // pixels per cell of the level sets

const cv::Scalar kInk(60, 60, 60);
const cv::Scalar kRed(80, 80, 220);
const cv::Scalar kDemonstration(200, 190, 180);
const cv::Scalar kGoal(80, 180, 80);
const cv::Scalar kWay(160, 80, 20);
const cv::Scalar kRecovery(30, 140, 240);

// A picture below its caption, and the part of the plane that it shows.
struct Canvas {
  cv::Mat image;
  View view;
  double scale;  // pixels per metre

  [[nodiscard]] cv::Point At(double x, double y) const {
    return {static_cast<int>(scale * (x - view.left)),
            kCaption + static_cast<int>(scale * (view.top - y))};
  }
};

// Draws the stay-out regions and the goal.
void DrawRegions(const Canvas& canvas, const Task& task) {
  cv::Mat image = canvas.image;
  if (const auto* corridor = dynamic_cast<const sim::CorridorPlant*>(task.plant.get())) {
    for (int row = kCaption; row < image.rows; ++row) {
      for (int col = 0; col < image.cols; ++col) {
        const double x = canvas.view.left + col / canvas.scale;
        const double y = canvas.view.top - (row - kCaption) / canvas.scale;
        if (corridor->Clearance(x, y) < 0.0) image.at<cv::Vec3b>(row, col) = {190, 190, 245};
      }
    }
    const double goal = corridor->options().length;
    cv::line(image, canvas.At(goal, canvas.view.bottom), canvas.At(goal, canvas.view.top), kGoal,
             2);
    return;
  }
  const auto& o = dynamic_cast<const sim::DiscPushPlant&>(*task.plant).options();
  for (const double side : {-1.0, 1.0}) {
    cv::circle(image, canvas.At(o.gate_x, side * o.gate_y),
               static_cast<int>(canvas.scale * o.red_radius), kRed, cv::FILLED, cv::LINE_AA);
  }
  cv::circle(image, canvas.At(o.goal_x, 0.0), static_cast<int>(canvas.scale * o.goal_radius), kGoal,
             2, cv::LINE_AA);
}

// Returns l at the shot's time step, clipped at -1, at the nodes of a grid of kGrid pixels over the
// plane.
cv::Mat LevelGrid(const Canvas& canvas, const Methods& methods, SupportKind support,
                  const Shot& shot, double& largest) {
  cv::Mat levels((canvas.image.rows - kCaption) / kGrid + 1, canvas.image.cols / kGrid + 1, CV_32F);
  std::vector<double> state = shot.x;
  for (int i = 0; i < levels.rows; ++i) {
    for (int j = 0; j < levels.cols; ++j) {
      state[state.size() - 2] = canvas.view.left + j * kGrid / canvas.scale;
      state[state.size() - 1] = canvas.view.top - i * kGrid / canvas.scale;
      const double l = methods.Level(support, shot.step.t, state);
      levels.at<float>(i, j) = static_cast<float>(std::max(l, -1.0));
      largest = std::max(largest, l);
    }
  }
  return levels;
}

// Draws level sets, darker towards the inside. White lines separate levels. A dark line marks the
// boundary, g = 0.
void DrawLevels(const Canvas& canvas, const Methods& methods, SupportKind support,
                const Shot& shot) {
  cv::Mat image = canvas.image;
  double largest = 1e-9;
  const cv::Mat levels = LevelGrid(canvas, methods, support, shot, largest);
  cv::Mat fine;
  cv::resize(levels, fine, levels.size() * kGrid, 0, 0, cv::INTER_LINEAR);
  const auto band = [&](int i, int j) {
    const double l = fine.at<float>(i, j);
    return l < 0.0 ? 0 : 1 + static_cast<int>(3.999 * std::min(1.0, l / largest));
  };
  for (int i = 0; i + 1 < std::min(fine.rows, image.rows - kCaption); ++i) {
    for (int j = 0; j + 1 < std::min(fine.cols, image.cols); ++j) {
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
}

void DrawWay(const Canvas& canvas, std::span<const Shot> shots) {
  for (std::size_t k = 0; k + 1 < shots.size(); ++k) {
    const Shot& from = shots[k];
    const Shot& to = shots[k + 1];
    const bool learned = from.step.mode == control::Mode::kPolicy && !from.step.filtered;
    for (std::size_t block = 0; block < from.x.size(); block += 2) {
      cv::line(canvas.image, canvas.At(from.x[block], from.x[block + 1]),
               canvas.At(to.x[block], to.x[block + 1]), learned ? kWay : kRecovery, 2, cv::LINE_AA);
    }
  }
}

// Draws the moving body and the circle that a control can reach.
void DrawBodies(const Canvas& canvas, const Task& task, const Shot& shot) {
  const cv::Point place = canvas.At(shot.x[0], shot.x[1]);
  if (const auto* push = dynamic_cast<const sim::DiscPushPlant*>(task.plant.get())) {
    const auto& o = push->options();
    cv::circle(canvas.image, canvas.At(shot.x[2], shot.x[3]),
               static_cast<int>(canvas.scale * o.object_radius), kInk, 2, cv::LINE_AA);
    cv::circle(canvas.image, place, static_cast<int>(canvas.scale * o.pusher_radius), kInk,
               cv::FILLED, cv::LINE_AA);
  } else {
    cv::circle(canvas.image, place, 6, kInk, cv::FILLED, cv::LINE_AA);
  }
  const double reach = shot.u.empty() ? 0.0 : Reach(task, shot.u);
  if (reach > 0.0) {
    cv::circle(canvas.image, place, static_cast<int>(canvas.scale * reach), kRecovery, 2,
               cv::LINE_AA);
  }
}

}  // namespace

void EpisodeRecorder::OnStart(std::span<const double> x) { last_.assign(x.begin(), x.end()); }

void EpisodeRecorder::OnControl(const control::RolloutEvent& event) {
  episode_->shots.push_back(
      {{event.x.begin(), event.x.end()}, {event.u.begin(), event.u.end()}, event.step});
  last_.assign(event.next_x.begin(), event.next_x.end());
}

void EpisodeRecorder::OnEnd(const control::RolloutResult& result) {
  episode_->shots.push_back({last_, {}, result.last_step});
  episode_->outcome = result.outcome;
  if (result.outcome == core::Outcome::kHalted) {
    episode_->cause = control::Name(result.halt_cause);
  }
}

std::vector<Episode> Record(const Task& task, const Methods& methods,
                            const std::vector<std::string>& names, std::uint64_t start_seed) {
  std::vector<Episode> episodes;
  for (const std::string& name : names) {
    Episode episode;
    episode.method = name;
    const auto plant = task.plant->Clone();
    const auto controller = methods.Make(name, *plant);
    EpisodeRecorder recorder(episode);
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

PlanePicture::PlanePicture(const Task& task)
    : task_(task),
      view_(ViewOf(task)),
      scale_(kNarrow / (view_.right - view_.left)),
      width_(kNarrow),
      height_(static_cast<int>(scale_ * (view_.top - view_.bottom)) / 2 * 2) {
  const int rows = kCaption + height_;
  background_.assign(static_cast<std::size_t>(width_) * static_cast<std::size_t>(rows) * 3, 255);
  DrawRegions({{rows, width_, CV_8UC3, background_.data()}, view_, scale_}, task_);
}

void PlanePicture::Draw(std::span<const double> x, std::span<std::uint8_t> rgb) const {
  std::vector<std::uint8_t> pixels = background_;
  const Canvas canvas{{kCaption + height_, width_, CV_8UC3, pixels.data()}, view_, scale_};
  DrawBodies(canvas, task_, {.x = {x.begin(), x.end()}, .u = {}, .step = {}});
  cv::Mat picture(height_, width_, CV_8UC3, rgb.data());
  cv::cvtColor(canvas.image.rowRange(kCaption, kCaption + height_), picture, cv::COLOR_BGR2RGB);
}

Painter::Painter(const Task& task, const Methods& methods)
    : task_(&task), methods_(&methods), view_(ViewOf(task)) {
  scale_ = kWidth / (view_.right - view_.left);
  width_ = kWidth;
  height_ = static_cast<int>(scale_ * (view_.top - view_.bottom)) / 2 * 2 + kCaption;
  background_.assign(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_) * 3, 255);
  const Canvas canvas{{height_, width_, CV_8UC3, background_.data()}, view_, scale_};
  DrawRegions(canvas, task);
  for (const core::Trajectory& d : methods.demonstrations()) {
    const Eigen::Index first = d.states.cols() - 2;
    for (Eigen::Index t = 0; t + 1 < d.states.rows(); ++t) {
      cv::line(canvas.image, canvas.At(d.states(t, first), d.states(t, first + 1)),
               canvas.At(d.states(t + 1, first), d.states(t + 1, first + 1)), kDemonstration, 1,
               cv::LINE_AA);
    }
  }
}

std::vector<std::uint8_t> Painter::Draw(const Episode& episode, int frame) const {
  std::vector<std::uint8_t> pixels = background_;
  const Canvas canvas{{height_, width_, CV_8UC3, pixels.data()}, view_, scale_};
  const int last = static_cast<int>(episode.shots.size()) - 1;
  const int now = std::clamp(frame, 0, last);
  const Shot& shot = episode.shots[static_cast<std::size_t>(now)];
  DrawLevels(canvas, *methods_, SupportOf(episode.method), shot);
  DrawWay(canvas, std::span(episode.shots).first(static_cast<std::size_t>(now) + 1));
  DrawBodies(canvas, *task_, shot);
  std::string what = control::Name(shot.step.mode);
  if (shot.step.filtered) what = "filtered policy";
  if (now == last) {
    what = std::string(core::Name(episode.outcome)) +
           (episode.cause.empty() ? "" : ": " + episode.cause);
  }
  const std::string caption = core::Format("%s   control %d   t = %d   %s", episode.method.c_str(),
                                           now, shot.step.t, what.c_str());
  cv::rectangle(canvas.image, cv::Rect(0, 0, width_, kCaption), cv::Scalar(240, 242, 243),
                cv::FILLED);
  cv::putText(canvas.image, caption, cv::Point(10, 22), cv::FONT_HERSHEY_SIMPLEX, 0.6, kInk, 1,
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
  apps::WritePicture(path, all);
}

void Painter::WriteVideo(const std::vector<Episode>& episodes,
                         const std::filesystem::path& path) const {
  const int count = static_cast<int>(episodes.size());
  apps::VideoWriter video(path, cv::Size(width_, count * height_), 12.0);
  std::size_t frames = 0;
  for (const Episode& e : episodes) frames = std::max(frames, e.shots.size());
  // DFR may need thousands of controls: the video then skips some of them.
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
  video.Commit();
}

}  // namespace dfr::study::planar
