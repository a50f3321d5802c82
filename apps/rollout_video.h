#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "dfr/control/rollout.h"
#include "dfr/core/decision_function.h"
#include "dfr/experiment/experiment.h"

namespace dfr::apps {

/// One picture of a rollout, with the controller's values at its time.
struct VideoFrame {
  std::vector<std::uint8_t> jpeg;
  control::Step step;
  double level = 0.0;      ///< g, or its log form if the controller uses it.
  double threshold = 0.0;  ///< Threshold of the gate, in the form of `level`; NaN: none.
  bool logarithmic = false;
  int controls = 0;  ///< Number of controls applied so far.

  void CopyLevel(const VideoFrame& other) {
    level = other.level;
    threshold = other.threshold;
    logarithmic = other.logarithmic;
  }
};

/// A rollout as compressed pictures.
struct RolloutVideo {
  std::string title;
  control::RolloutResult result;
  std::vector<VideoFrame> frames;
};

/// Takes a picture after every control of the learned policy, and after every `recovery_stride`-th
/// control of a recovery, because recoveries have many small controls.
class RolloutVideoRecorder final : public control::RolloutObserver {
 public:
  /// Draws the plant's present state: width x height RGB bytes, top row first.
  using Draw = std::function<void(std::span<std::uint8_t> rgb)>;

  /// Borrows `support`; its g is shown if the controller has none.
  RolloutVideoRecorder(std::string title, int width, int height, Draw draw,
                       const core::DecisionFunction& support, int recovery_stride = 8);

  void OnStart(std::span<const double> x) override;
  void OnControl(const control::RolloutEvent& event) override;
  void OnEnd(const control::RolloutResult& result) override;

  [[nodiscard]] RolloutVideo Take() { return std::move(video_); }

 private:
  void Capture(const control::Step& step, std::span<const double> x);

  int width_;
  int height_;
  Draw draw_;
  const core::DecisionFunction* support_;
  int recovery_stride_;
  RolloutVideo video_;
  std::vector<std::uint8_t> rgb_;
  std::vector<double> last_x_;
  int controls_ = 0;
  int recovery_controls_ = 0;
};

/// Writes videos side by side, each over its decision function g(t), the gate's threshold and the
/// mode. A video that ends early shows its last picture with its outcome until the end. The ending
/// of `path` chooses the format: .mp4 (H.264) or .webm (VP8).
/// @throws std::runtime_error naming the file if it cannot be written or its ending is unknown.
void WriteVideo(const std::filesystem::path& path, std::span<const RolloutVideo> videos);

/// Draws one picture of width x height and encodes a test video beside `path`. Finds faults that
/// would stop WriteVideo() before any rollout runs. @throws std::runtime_error naming the cause.
void CheckVideo(const std::filesystem::path& path, int width, int height,
                const RolloutVideoRecorder::Draw& draw);

/// Calls `check(options.out / "rollouts.mp4")` if an experiment with these options ends with
/// videos, and adds --no-video as a remedy to its error.
void CheckExperimentVideo(const experiment::ExperimentOptions& options,
                          const std::function<void(const std::filesystem::path&)>& check);

/// Writes picture `index` of each video, or the last picture of a shorter video. The ending of
/// `path` chooses PNG or JPEG.
void WriteStill(const std::filesystem::path& path, std::span<const RolloutVideo> videos,
                std::size_t index);

}  // namespace dfr::apps
