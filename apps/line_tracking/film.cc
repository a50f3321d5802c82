#include "film.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>
#include <stdexcept>
#include <vector>

#include "dfr/kinematics/sprk_platform.h"

namespace dfr::apps {
namespace {

using kinematics::SprkPlatform;
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
const cv::Scalar kRed(40, 40, 200);
const cv::Scalar kSeen(220, 200, 0);

void Write(cv::Mat& canvas, const std::string& text, cv::Point at, const cv::Scalar& colour,
           double scale = 0.5) {
  cv::putText(canvas, text, at, cv::FONT_HERSHEY_SIMPLEX, scale, colour, 1, cv::LINE_AA);
}

// A camera that looks at arm and platform from outside.
class OutsideView {
 public:
  OutsideView() {
    const Eigen::Vector3d eye(0.26, -0.30, 0.20);
    const Eigen::Vector3d forward = (Eigen::Vector3d(0.0, 0.015, 0.0) - eye).normalized();
    const Eigen::Vector3d right = forward.cross(Eigen::Vector3d::UnitZ()).normalized();
    rotation_ << right, -right.cross(forward), forward;
    rotation_.transposeInPlace();
    rotation_.row(1) = -right.cross(forward).transpose();
    eye_ = eye;
  }

  [[nodiscard]] cv::Point At(const Eigen::Vector3d& p) const {
    const Eigen::Vector3d c = rotation_ * (p - eye_);
    return {static_cast<int>(kWidth / 2 + 950.0 * c.x() / c.z()),
            static_cast<int>(kHeight / 2 - 40 + 950.0 * c.y() / c.z())};
  }

  [[nodiscard]] cv::Mat Draw(const LineTrackingPlant& plant) const {
    cv::Mat canvas(kHeight, kWidth, CV_8UC3, kPaper);
    const sim::LineTrackingTruth truth = plant.truth();
    const auto polygon = [&](const std::vector<Eigen::Vector3d>& corners,
                             const cv::Scalar& colour) {
      std::vector<cv::Point> points;
      for (const Eigen::Vector3d& corner : corners) points.push_back(At(corner));
      cv::fillConvexPoly(canvas, points, colour, cv::LINE_AA);
    };
    const auto line = [&](const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                          const cv::Scalar& colour, int thickness) {
      cv::line(canvas, At(a), At(b), colour, thickness, cv::LINE_AA);
    };
    // Base, servo arms and legs. The gauze is on the plate, kHomeHeight above the servos.
    const Eigen::Vector3d down(0.0, 0.0, -SprkPlatform::kHomeHeight);
    std::vector<Eigen::Vector3d> base;
    std::vector<Eigen::Vector3d> plate;
    kinematics::PlatformPose pose;
    pose.translation_m = truth.p_world_gauze.translation();
    pose.angles_rad = truth.p_world_gauze.linear().eulerAngles(2, 1, 0).reverse();
    std::array<double, 6> servo{};
    const bool solved = SprkPlatform::Inverse(pose, servo);
    for (int i = 0; i < 6; ++i) {
      base.push_back(down + SprkPlatform::ServoAxis(i));
      plate.push_back(truth.p_world_gauze * SprkPlatform::PlateJoint(i));
    }
    polygon(base, kFaint);
    for (int i = 0; i < 6; ++i) {
      const auto k = static_cast<std::size_t>(i);
      const Eigen::Vector3d arm =
          solved ? Eigen::Vector3d(down + SprkPlatform::ArmEnd(i, servo[k])) : base[k];
      line(base[k], arm, kInk, 5);
      line(arm, plate[k], kInk, 2);
    }
    polygon(plate, cv::Scalar(170, 166, 160));
    const auto rectangle = [&](double x, double y) {
      std::vector<Eigen::Vector3d> corners;
      for (const auto& [sx, sy] : {std::pair{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}) {
        corners.push_back(truth.p_world_gauze * Eigen::Vector3d(sx * x, sy * y, 0.0));
      }
      return corners;
    };
    polygon(rectangle(0.042, 0.031), cv::Scalar(128, 128, 128));
    polygon(rectangle(0.034, 0.022), cv::Scalar(225, 230, 235));
    const vision::LineObservation& seen = plant.last_observation();
    if (seen.seen()) {
      for (double x = seen.x_min; x < seen.x_max; x += 0.002) {
        const auto on_line = [&](double at) {
          return Eigen::Vector3d(
              truth.p_world_gauze *
              Eigen::Vector3d(at, seen.line[0] + at * (seen.line[1] + at * seen.line[2]), 0.0));
        };
        line(on_line(x), on_line(std::min(x + 0.002, seen.x_max)), kRed, 2);
      }
    }
    const kinematics::PsmJoints q = plant.true_joints();
    const Eigen::Isometry3d from_base = LineTrackingPlant::p_world_base();
    const Eigen::Vector3d wrist = from_base * kinematics::Psm::Forward(q).translation();
    const Eigen::Vector3d shaft = from_base * kinematics::Psm::ShaftEnd(q);
    const Eigen::Vector3d remote_centre = from_base.translation();
    line(remote_centre, shaft, cv::Scalar(70, 70, 70), 10);
    line(shaft, wrist, cv::Scalar(120, 120, 120), 7);
    line(wrist, truth.tip_m, cv::Scalar(120, 120, 120), 4);
    cv::circle(canvas, At(truth.tip_m), 4, cv::Scalar(60, 170, 40), cv::FILLED, cv::LINE_AA);
    cv::circle(canvas, At(remote_centre), 6, kRecoveryColour, 2, cv::LINE_AA);
    return canvas;
  }

 private:
  Eigen::Matrix3d rotation_;
  Eigen::Vector3d eye_;
};

// What vision sees, over the picture that it saw.
void DrawSeen(cv::Mat& picture, const LineTrackingPlant& plant) {
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
  for (double x = seen.x_min; x < seen.x_max; x += 0.001) {
    const double y = seen.line[0] + x * (seen.line[1] + x * seen.line[2]);
    curve.push_back(to_point(camera.Project(seen.p_cam_target * Eigen::Vector3d(x, y, 0.0))));
  }
  cv::polylines(picture, curve, false, kSeen, 1, cv::LINE_AA);
  cv::circle(picture, to_point(seen.tip_pixel), 12, kSeen, 1, cv::LINE_AA);
  char text[96];
  std::snprintf(text, sizeof text, "distance %+.2f mm (true %+.2f)  tracked %.1f mm",
                1e3 * seen.distance_m, 1e3 * plant.truth().distance_m,
                1e3 * plant.truth().progress_m);
  Write(picture, text, {20, 460}, kSeen, 0.55);
}

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
    samples_.push_back({event.step.g, event.step.threshold, event.step.mode});
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
    plant_.RenderEndoscope(picture_);
    cv::Mat endoscope = cv::Mat(plant_.endoscope().camera().height,
                                plant_.endoscope().camera().width, CV_8UC3, picture_.data())
                            .clone();
    DrawSeen(endoscope, plant_);
    cv::Mat frame(kHeight + kStripHeight, 2 * kWidth, CV_8UC3, kPaper);
    endoscope.copyTo(frame(cv::Rect(0, 0, kWidth, kHeight)));
    outside_.Draw(plant_).copyTo(frame(cv::Rect(kWidth, 0, kWidth, kHeight)));
    Write(frame, title_ + (ending_.empty() ? "" : "   " + ending_), {kWidth + 20, 30}, kInk, 0.6);
    cv::Mat strip = frame(cv::Rect(0, kHeight, 2 * kWidth, kStripHeight));
    DrawStrip(strip);
    frames_.push_back(frame);
  }

  // g over the controls so far, the threshold, and who chose each control.
  void DrawStrip(cv::Mat& strip) const {
    Write(strip, "g(t), threshold; blue: learned policy, orange: recovery", {12, 18}, kInk, 0.42);
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
  std::vector<std::uint8_t> picture_;
  std::vector<Sample> samples_;
  std::vector<cv::Mat> frames_;
  OutsideView outside_;
  int recovery_controls_ = 0;
};

}  // namespace

control::RolloutResult RecordEpisode(LineSite& site, int method, const std::string& title,
                                     std::uint64_t start_seed, std::uint64_t controller_seed,
                                     const std::filesystem::path& path) {
  int codec = 0;
  if (path.extension() == ".mp4") {
    codec = cv::VideoWriter::fourcc('a', 'v', 'c', '1');
  } else if (path.extension() == ".webm") {
    codec = cv::VideoWriter::fourcc('V', 'P', '8', '0');
  } else {
    throw std::runtime_error(path.string() + ": a video's name ends in .mp4 or .webm");
  }
  Recorder recorder(site.plant(), title);
  const control::RolloutResult result = site.Watch(method, start_seed, controller_seed, &recorder);
  cv::VideoWriter writer(path.string(), cv::CAP_FFMPEG, codec, kFramesPerSecond,
                         recorder.frames().front().size());
  if (!writer.isOpened()) {
    throw std::runtime_error(path.string() +
                             ": the video cannot be written here; does its folder "
                             "exist?");
  }
  for (const cv::Mat& frame : recorder.frames()) writer.write(frame);
  return result;
}

}  // namespace dfr::apps
