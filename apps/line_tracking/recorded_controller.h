#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>

#include "dfr/control/controller.h"
#include "dfr/recording/recorder.h"

namespace dfr::apps::line_tracking {

/// Wraps another controller and passes each decision to observers before the control is applied.
/// Does not allocate or throw if the observers do not.
class RecordedController final : public control::Controller {
 public:
  /// Borrows `controller`. @param recorder  may be nullptr, otherwise must outlive this object.
  RecordedController(control::Controller& controller, recording::Recorder* recorder)
      : controller_(&controller), recorder_(recorder) {}

  [[nodiscard]] int state_dim() const noexcept override { return controller_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return controller_->control_dim(); }

  /// Sets the number of the episode to which the following decisions belong.
  void BeginEpisode(std::uint64_t episode) noexcept { episode_ = episode; }
  /// Records a decision that was made without the controller, for an invalid state.
  void Record(const control::Step& step, std::span<const double> x,
              std::span<const double> u) noexcept;

  /// Adds picture and machine state to the records; may be empty.
  std::function<void(recording::StepRecord&)> describe;
  /// Receives each decision before it is applied.
  std::function<void(const control::Step&)> on_decision;

 private:
  void DoReset(std::uint64_t seed) noexcept override;
  [[nodiscard]] control::Step DoNext(std::span<const double> x,
                                     std::span<double> u) noexcept override;

  control::Controller* controller_;
  recording::Recorder* recorder_;
  std::uint64_t episode_ = 0;
  std::uint64_t seed_ = 0;
  double decision_s_ = 0.0;
};

/// Repeats the decisions of a recording with `model` or, if `model` is empty, with the model that
/// the recording names. Prints the differences. Returns true if there are none.
/// @throws std::runtime_error if recording or model cannot be read.
[[nodiscard]] bool ReplayRecording(const std::filesystem::path& recording,
                                   const std::filesystem::path& model);

}  // namespace dfr::apps::line_tracking
