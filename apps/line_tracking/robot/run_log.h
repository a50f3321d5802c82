#pragma once

#include <cstdint>
#include <functional>
#include <utility>

#include "dfr/hardware/psm_driver.h"
#include "dfr/recording/recorder.h"
#include "dfr/robot/devices.h"
#include "dfr/runtime/fail_safe.h"

namespace dfr::apps::line_tracking {

/// Sends transitions to the recording and to the operator, and the arm's states to the recording.
class RunLog final : public robot::Recorder {
 public:
  RunLog(recording::Recorder* recorder, const hardware::PsmDriver& driver, bool stop_required,
         std::function<void(const runtime::Transition&)> on_transition)
      : recorder_(recorder),
        driver_(&driver),
        stop_required_(stop_required),
        on_transition_(std::move(on_transition)) {}

  [[nodiscard]] bool failed() const noexcept override {
    return recorder_ != nullptr && recorder_->failed();
  }
  void Write(const runtime::Transition& transition, std::int64_t wall_ns) noexcept override;
  void Period(const robot::Finding& arm, const robot::Finding& stop, runtime::RunState state,
              std::int64_t wall_ns) noexcept override;

 private:
  recording::Recorder* recorder_;
  const hardware::PsmDriver* driver_;
  bool stop_required_;
  std::uint64_t num_samples_ = 0;
  runtime::HoldReason arm_ = runtime::HoldReason::kNone;
  runtime::HoldReason stop_ = runtime::HoldReason::kNone;
  runtime::RunState state_ = runtime::RunState::kIdle;
  std::function<void(const runtime::Transition&)> on_transition_;
};

}  // namespace dfr::apps::line_tracking
