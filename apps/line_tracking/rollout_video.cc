#include "rollout_video.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <stdexcept>
#include <vector>

#include "apps/video_writer.h"
#include "dfr/core/format.h"

namespace dfr::apps::line_tracking {
namespace {

using sim::LineTrackingPlant;

constexpr int kWidth = 640;
constexpr int kHeight = 480;
constexpr int kStripHeight = 160;
constexpr int kRecoveryStride = 10;
constexpr int kHoldFrames = 20;
constexpr double kFramesPerSecond = 12.0;

// Blue, green, red.
const cv::Scalar kPaper(250, 250, 250);
const cv::Scalar kInk(45, 42, 40);
const cv::Scalar kFaint(200, 196, 192);
const cv::Scalar kPolicyColour(178, 114, 0);
const cv::Scalar kRecoveryColour(0, 110, 213);
const cv::Scalar kSeen(220, 200, 0);

void Write(cv::Mat& canvas, const std::string& text, cv::Point at, const cv::Scalar& colour,
           double scale = 0.5) {
  cv::putText(canvas, text, at, cv::FONT_HERSHEY_SIMPLEX, scale, colour, 1, cv::LINE_AA);
}

// What vision sees, over the picture that it saw.
void DrawSeen(cv::Mat& picture, const LineTrackingPlant& plant) {
  if (plant.options().observation == sim::Observation::kGroundTruth) {
    Write(picture,
          core::Format("not looked at: true distance %+.2f mm  tracked %.1f mm",
                       1e3 * plant.truth().distance_m, 1e3 * plant.truth().progress_m),
          {20, 460}, kSeen, 0.55);
    return;
  }
  const vision::LineObservation& seen = plant.last_observation();
  if (!seen.seen()) {
    Write(picture, std::string("not seen: ") + vision::Name(seen.missing), {20, 460}, kSeen, 0.6);
    return;
  }
  const vision::CameraModel& camera = plant.calibration().camera;
  const auto to_point = [](const Eigen::Vector2d& p) {
    return cv::Point(static_cast<int>(std::lround(p.x())), static_cast<int>(std::lround(p.y())));
  };
  std::vector<cv::Point> curve;
  curve.reserve(61);
  constexpr int kPieces = 60;
  for (int i = 0; i <= kPieces; ++i) {
    const double x = seen.x_min + (seen.x_max - seen.x_min) * i / kPieces;
    const double y = seen.line[0] + x * (seen.line[1] + x * seen.line[2]);
    curve.push_back(to_point(camera.Project(seen.p_cam_target * Eigen::Vector3d(x, y, 0.0))));
  }
  cv::polylines(picture, curve, false, kSeen, 1, cv::LINE_AA);
  cv::circle(picture, to_point(seen.tip_pixel), 12, kSeen, 1, cv::LINE_AA);
  Write(picture,
        core::Format("distance %+.2f mm (true %+.2f)  tracked %.1f mm", 1e3 * seen.distance_m,
                     1e3 * plant.truth().distance_m, 1e3 * plant.truth().progress_m),
        {20, 460}, kSeen, 0.55);
}

}  // namespace

std::vector<std::uint8_t> DrawWhatVisionSees(const LineTrackingPlant& plant) {
  std::vector<std::uint8_t> bgr(plant.endoscope().image_size());
  plant.RenderEndoscope(bgr);
  cv::Mat picture(kHeight, kWidth, CV_8UC3, bgr.data());
  DrawSeen(picture, plant);
  return bgr;
}

namespace {

struct Sample {
  double g = 0.0;
  double threshold = 0.0;
  control::Mode mode = control::Mode::kPolicy;
};

class Recorder final : public control::RolloutObserver {
 public:
  Recorder(const LineTrackingPlant& plant, std::string title)
      : plant_(plant), title_(std::move(title)), picture_(plant.endoscope().image_size()) {}

  void OnStart(std::span<const double> /*x*/) override { Capture(); }
  void OnControl(const control::RolloutEvent& event) override {
    const control::Step& step = event.step;
    // Guided recovery works with the log form.
    log_form_ = std::isfinite(step.log_g);
    samples_.push_back({log_form_ ? step.log_g : step.g,
                        log_form_ ? step.log_threshold : step.threshold, step.mode});
    mode_ = std::string("t = ") + std::to_string(step.t) + ", " + control::Name(step.mode) +
            (step.filtered ? ", filtered" : "");
    const bool policy = event.step.mode == control::Mode::kPolicy;
    if (policy || event.collided || event.completed ||
        ++recovery_controls_ % kRecoveryStride == 1) {
      Capture();
    }
  }
  void OnEnd(const control::RolloutResult& result) override {
    ending_ = core::Name(result.outcome);
    if (result.outcome == core::Outcome::kHalted) {
      ending_ += std::string(": ") + control::Name(result.halt_cause);
    }
    Capture();
    for (int i = 0; i < kHoldFrames; ++i) frames_.push_back(frames_.back());
  }

  [[nodiscard]] const std::vector<cv::Mat>& frames() const { return frames_; }

 private:
  void Capture() {
    std::vector<std::uint8_t> seen = DrawWhatVisionSees(plant_);
    const cv::Mat endoscope(kHeight, kWidth, CV_8UC3, seen.data());
    cv::Mat frame(kHeight + kStripHeight, 2 * kWidth, CV_8UC3, kPaper);
    endoscope.copyTo(frame(cv::Rect(0, 0, kWidth, kHeight)));
    plant_.RenderOutside(picture_);
    cv::Mat outside;
    cv::cvtColor(cv::Mat(kHeight, kWidth, CV_8UC3, picture_.data()), outside, cv::COLOR_RGB2BGR);
    outside.copyTo(frame(cv::Rect(kWidth, 0, kWidth, kHeight)));
    Write(frame, title_ + (ending_.empty() ? "" : "   " + ending_), {kWidth + 20, 30}, kPaper, 0.6);
    Write(frame, mode_, {kWidth + 20, 56}, kPaper, 0.5);
    cv::Mat strip = frame(cv::Rect(0, kHeight, 2 * kWidth, kStripHeight));
    DrawStrip(strip);
    frames_.push_back(frame);
  }

  // g over the controls so far, the threshold, and who chose each control.
  void DrawStrip(cv::Mat& strip) const {
    Write(strip,
          std::string(log_form_ ? "log form of g(t), 0 at the support's boundary"
                                : "g(t), 0 at the support's boundary") +
              "; grey: the gate's threshold; blue: learned policy, orange: recovery",
          {12, 18}, kInk, 0.42);
    double high = 1e-9;
    double low = 0.0;
    for (const Sample& s : samples_) {
      if (std::isfinite(s.g)) {
        high = std::max(high, s.g);
        low = std::min(low, s.g);
      }
      if (std::isfinite(s.threshold)) high = std::max(high, s.threshold);
    }
    const auto point = [&](std::size_t i, double value) {
      const double x = 12.0 + (2 * kWidth - 24.0) * static_cast<double>(i) /
                                  std::max<double>(60.0, static_cast<double>(samples_.size()));
      const double y = kStripHeight - 12.0 - (kStripHeight - 40.0) * (value - low) / (high - low);
      return cv::Point(static_cast<int>(x), static_cast<int>(y));
    };
    cv::line(strip, {12, point(0, 0.0).y}, {2 * kWidth - 12, point(0, 0.0).y}, kFaint, 1);
    for (std::size_t i = 1; i < samples_.size(); ++i) {
      const Sample& a = samples_[i - 1];
      const Sample& b = samples_[i];
      const bool policy = b.mode == control::Mode::kPolicy;
      if (std::isfinite(a.threshold) && std::isfinite(b.threshold)) {
        cv::line(strip, point(i - 1, a.threshold), point(i, b.threshold), kFaint, 1, cv::LINE_AA);
      }
      if (std::isfinite(a.g) && std::isfinite(b.g)) {
        cv::line(strip, point(i - 1, a.g), point(i, b.g), policy ? kPolicyColour : kRecoveryColour,
                 2, cv::LINE_AA);
      }
    }
  }

  const LineTrackingPlant& plant_;
  std::string title_;
  std::string ending_;
  std::string mode_;
  bool log_form_ = false;
  std::vector<std::uint8_t> picture_;
  std::vector<Sample> samples_;
  std::vector<cv::Mat> frames_;
  int recovery_controls_ = 0;
};

}  // namespace

control::RolloutResult RecordEpisode(LineTrialRunner& runner, int method, const std::string& title,
                                     std::uint64_t start_seed, std::uint64_t controller_seed,
                                     const std::filesystem::path& path) {
  // Opened first: a name that it refuses is refused before an episode runs.
  VideoWriter writer(path, {2 * kWidth, kHeight + kStripHeight}, kFramesPerSecond);
  Recorder recorder(runner.plant(), title);
  const control::RolloutResult result =
      runner.Watch(method, start_seed, controller_seed, &recorder);
  for (const cv::Mat& frame : recorder.frames()) writer.Write(frame);
  return result;
}

}  // namespace dfr::apps::line_tracking
