#include "apps/rollout_video.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

#include "apps/video_writer.h"
#include "dfr/core/text/format.h"

namespace dfr::apps {
namespace {

constexpr int kStripHeight = 150;
constexpr int kHeaderHeight = 44;
constexpr int kMargin = 12;
constexpr double kFramesPerSecond = 15.0;
constexpr int kHoldFrames = 20;  // number of frames after the end of the longest video

// Channels are blue, green, red, as in OpenCV. Colour-blind readers can distinguish the colours.
const cv::Scalar kPaper(252, 251, 250);
const cv::Scalar kInk(45, 42, 40);
const cv::Scalar kFaint(205, 200, 196);
const cv::Scalar kPolicyColour(178, 114, 0);
const cv::Scalar kRecoveryColour(0, 110, 213);
const cv::Scalar kThresholdColour(120, 116, 112);
const cv::Scalar kCollidedColour(30, 20, 190);
const cv::Scalar kCompletedColour(80, 140, 20);

cv::Scalar Colour(control::Mode mode) {
  switch (mode) {
    case control::Mode::kPolicy:
      return kPolicyColour;
    case control::Mode::kProbe:
    case control::Mode::kRecovery:
      return kRecoveryColour;
    case control::Mode::kHalt:
      break;
  }
  return kInk;
}

void Write(cv::Mat& canvas, const std::string& text, cv::Point at, double scale,
           const cv::Scalar& colour, int thickness = 1) {
  cv::putText(canvas, text, at, cv::FONT_HERSHEY_SIMPLEX, scale, colour, thickness, cv::LINE_AA);
}

// Range of the vertical axis: contains zero and all finite values given to Include().
struct Range {
  double low = 0.0;
  double high = 1e-6;
  void Include(double value) {
    if (!std::isfinite(value)) return;
    low = std::min(low, value);
    high = std::max(high, value);
  }
};

Range RangeOf(const RolloutVideo& video) {
  Range range;
  for (const VideoFrame& frame : video.frames) {
    range.Include(frame.level);
    range.Include(std::min(frame.threshold, 4.0 * std::max(range.high, 1e-3)));
  }
  return range;
}

// Draws g over the frames up to `now`, the gate's threshold, and the boundary g = 0.
void DrawStrip(cv::Mat& strip, const RolloutVideo& video, std::size_t now) {
  strip.setTo(kPaper);
  const Range range = RangeOf(video);
  const int left = 56;
  const int right = strip.cols - kMargin;
  const int top = 26;
  const int bottom = strip.rows - 16;
  const auto x_of = [&](std::size_t i) {
    const double f = video.frames.size() > 1
                         ? static_cast<double>(i) / static_cast<double>(video.frames.size() - 1)
                         : 0.0;
    return left + static_cast<int>(std::lround(f * (right - left)));
  };
  const auto y_of = [&](double value) {
    const double f = std::clamp((value - range.low) / (range.high - range.low), 0.0, 1.0);
    return bottom - static_cast<int>(std::lround(f * (bottom - top)));
  };
  cv::line(strip, {left, y_of(0.0)}, {right, y_of(0.0)}, kFaint, 1, cv::LINE_AA);
  const bool logarithmic = video.frames.back().logarithmic;
  Write(strip, logarithmic ? "l = 0" : "g = 0", {8, y_of(0.0) + 4}, 0.38, kInk);
  Write(strip, logarithmic ? "log decision function l" : "decision function g", {left, 16}, 0.42,
        kInk);
  Write(strip, "threshold", {left + 190, 16}, 0.42, kThresholdColour);
  for (std::size_t i = 1; i <= now && i < video.frames.size(); ++i) {
    const VideoFrame& a = video.frames[i - 1];
    const VideoFrame& b = video.frames[i];
    if (std::isfinite(a.threshold) && std::isfinite(b.threshold)) {
      cv::line(strip, {x_of(i - 1), y_of(a.threshold)}, {x_of(i), y_of(b.threshold)},
               kThresholdColour, 1, cv::LINE_AA);
    }
    if (std::isfinite(a.level) && std::isfinite(b.level)) {
      cv::line(strip, {x_of(i - 1), y_of(a.level)}, {x_of(i), y_of(b.level)}, Colour(b.step.mode),
               2, cv::LINE_AA);
    }
  }
  if (now < video.frames.size() && std::isfinite(video.frames[now].level)) {
    cv::circle(strip, {x_of(now), y_of(video.frames[now].level)}, 4,
               Colour(video.frames[now].step.mode), cv::FILLED, cv::LINE_AA);
  }
}

std::string StateText(const RolloutVideo& video, std::size_t now, cv::Scalar& colour) {
  const VideoFrame& frame = video.frames[now];
  if (now + 1 == video.frames.size()) {
    colour = video.result.outcome == core::Outcome::kCollided    ? kCollidedColour
             : video.result.outcome == core::Outcome::kCompleted ? kCompletedColour
                                                                 : kInk;
    const bool halted = video.result.outcome == core::Outcome::kHalted;
    return core::Format("%s%s%s after %d controls", core::Name(video.result.outcome),
                        halted ? ": " : "", halted ? control::Name(video.result.halt_cause) : "",
                        frame.controls);
  }
  colour = Colour(frame.step.mode);
  const bool recovering =
      frame.step.mode == control::Mode::kProbe || frame.step.mode == control::Mode::kRecovery;
  if (recovering) {
    return core::Format("t = %d  recovery, iteration %d", frame.step.t, frame.step.iteration);
  }
  return core::Format("t = %d  learned policy%s", frame.step.t,
                      frame.step.filtered ? ", filtered" : "");
}

cv::Mat Panel(const RolloutVideo& video, std::size_t frame) {
  const std::size_t now = std::min(frame, video.frames.size() - 1);
  const cv::Mat picture = cv::imdecode(video.frames[now].jpeg, cv::IMREAD_COLOR);
  cv::Mat panel(kHeaderHeight + picture.rows + kStripHeight, picture.cols, CV_8UC3, kPaper);
  picture.copyTo(panel(cv::Rect(0, kHeaderHeight, picture.cols, picture.rows)));
  cv::Mat strip = panel(cv::Rect(0, kHeaderHeight + picture.rows, picture.cols, kStripHeight));
  DrawStrip(strip, video, now);
  Write(panel, video.title, {kMargin, 18}, 0.52, kInk, 1);
  cv::Scalar colour;
  const std::string state = StateText(video, now, colour);
  Write(panel, state, {kMargin, 38}, 0.46, colour, 1);
  return panel;
}

cv::Mat Composite(std::span<const RolloutVideo> videos, std::size_t frame) {
  std::vector<cv::Mat> panels;
  for (const RolloutVideo& video : videos) {
    if (!panels.empty()) {
      panels.emplace_back(panels.front().rows, 4, CV_8UC3, kFaint);
    }
    panels.push_back(Panel(video, frame));
  }
  cv::Mat canvas;
  cv::hconcat(panels, canvas);
  return canvas;
}

void CheckVideos(std::span<const RolloutVideo> videos) {
  if (videos.empty() || std::any_of(videos.begin(), videos.end(), [](const RolloutVideo& video) {
        return video.frames.empty();
      })) {
    throw std::runtime_error("no picture to write: no rollout was recorded");
  }
}

}  // namespace

RolloutVideoRecorder::RolloutVideoRecorder(std::string title, int width, int height, Draw draw,
                                           const core::DecisionFunction& support,
                                           int recovery_stride)
    : width_(width),
      height_(height),
      draw_(std::move(draw)),
      support_(&support),
      recovery_stride_(recovery_stride),
      rgb_(static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * 3) {
  video_.title = std::move(title);
}

void RolloutVideoRecorder::Capture(const control::Step& step, std::span<const double> x) {
  draw_(rgb_);
  const cv::Mat rgb(height_, width_, CV_8UC3, rgb_.data());
  cv::Mat bgr;
  cv::cvtColor(rgb, bgr, cv::COLOR_RGB2BGR);
  VideoFrame frame;
  cv::imencode(".jpg", bgr, frame.jpeg, {cv::IMWRITE_JPEG_QUALITY, 92});
  frame.step = step;
  frame.logarithmic = std::isfinite(step.log_g);
  frame.level = frame.logarithmic       ? step.log_g
                : std::isfinite(step.g) ? step.g
                                        : support_->Decision(step.t, x);
  frame.threshold = frame.logarithmic ? step.log_threshold : step.threshold;
  frame.controls = controls_;
  video_.frames.push_back(std::move(frame));
}

void RolloutVideoRecorder::OnStart(std::span<const double> x) {
  control::Step step;
  step.mode = control::Mode::kPolicy;
  last_x_.assign(x.begin(), x.end());
  Capture(step, x);
}

void RolloutVideoRecorder::OnControl(const control::RolloutEvent& event) {
  ++controls_;
  last_x_.assign(event.next_x.begin(), event.next_x.end());
  const bool policy = event.step.mode == control::Mode::kPolicy;
  if (!policy) ++recovery_controls_;
  if (policy || event.collided || event.completed || recovery_controls_ % recovery_stride_ == 1) {
    Capture(event.step, event.x);
    // The start state's picture precedes the first control, which determines its level.
    if (video_.frames.size() == 2) video_.frames.front().CopyLevel(video_.frames.back());
  }
}

void RolloutVideoRecorder::OnEnd(const control::RolloutResult& result) {
  video_.result = result;
  Capture(result.last_step, last_x_);
}

void WriteVideo(const std::filesystem::path& path, std::span<const RolloutVideo> videos) {
  CheckVideos(videos);
  std::size_t frames = 0;
  for (const RolloutVideo& video : videos) frames = std::max(frames, video.frames.size());
  VideoWriter writer(path, Composite(videos, 0).size(), kFramesPerSecond);
  for (std::size_t i = 0; i < frames + kHoldFrames; ++i) writer.Write(Composite(videos, i));
  writer.Commit();
}

void CheckVideo(const std::filesystem::path& path, int width, int height,
                const RolloutVideoRecorder::Draw& draw) {
  std::vector<std::uint8_t> rgb(3 * static_cast<std::size_t>(width) *
                                static_cast<std::size_t>(height));
  draw(rgb);
  VideoWriter::Check(path);
}

void CheckExperimentVideo(const experiment::ExperimentOptions& options,
                          const std::function<void(const std::filesystem::path&)>& check) {
  if (!options.video || options.shard != experiment::Shard() || !options.rerun.episode.empty()) {
    return;
  }
  try {
    check(options.out / "rollouts.mp4");
  } catch (const std::runtime_error& e) {
    throw std::runtime_error(std::string(e.what()) + "; --no-video leaves the videos out");
  }
}

void WriteStill(const std::filesystem::path& path, std::span<const RolloutVideo> videos,
                std::size_t index) {
  CheckVideos(videos);
  WritePicture(path, Composite(videos, index));
}

}  // namespace dfr::apps
