#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "dfr/control/controller.h"
#include "dfr/core/plant.h"
#include "dfr/recording/recorder.h"
#include "dfr/runtime/fail_safe.h"
#include "dfr/vision/line_vision.h"
#include "robot_config.h"

namespace dfr::apps::line_tracking {

/// How the control loop kept its time.
struct LoopTimes {
  std::int64_t periods = 0;
  std::int64_t missed = 0;
  double jitter_p50_s = 0.0;
  double jitter_p999_s = 0.0;
  double worst_s = 0.0;
};

/// Line tracking on an arm behind a console: the same states and controls as
/// sim::LineTrackingPlant, over the network. A console of dvrk_simulator's is told of episodes and
/// asked for the truth; on a robot the operator sets up each episode, and camera and encoders alone
/// say how it went.
///
/// Its loop runs while Apply(), Observe()'s pictures and Idle() wait, and in every period looks at
/// all that can be in doubt: arm, camera, emergency stop, its own time. FailSafe decides; whatever
/// is in doubt, the arm is told to hold and Apply() returns kFault from then on until Start().
///
/// Apply() allocates nothing of its own; with a simulator it asks for the truth, which does. One
/// object belongs to the thread that made it.
class RobotPlant final : public core::Plant {
 public:
  /// Joins the network and waits for the devices.
  /// @param recorder  gets transitions and pictures; may be nullptr, else outlives this.
  /// @throws std::runtime_error naming the device that is not there, and what to do.
  RobotPlant(const RobotConfig& config, const line_task::LineCalibration& calibration,
             recording::Recorder* recorder);
  ~RobotPlant() override;

  /// Homes the arm if need be, saying what it waits for. @throws std::runtime_error
  void BringUp(const std::function<void(std::string_view)>& say);
  /// Runs the loop for so long, the arm at rest.
  void Idle(double seconds) noexcept;
  /// An operator's words. Start() arms the machine and the arm, and starts; kNone, or what keeps it
  /// from that.
  [[nodiscard]] runtime::Doubt Start() noexcept;
  [[nodiscard]] bool Clear() noexcept;
  /// Somebody outside is in doubt: it stands still from now on.
  void Doubted(runtime::Doubt doubt, std::string_view detail) noexcept;

  /// What the controller has decided, before Apply(): whether the policy or a recovery drives, or
  /// why it halts.
  void Decided(const control::Step& step) noexcept;

  [[nodiscard]] const core::StateLayout& layout() const noexcept override;
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  /// With a simulator: the next episode, which starts as soon as nothing is in doubt any more. On a
  /// robot the tip is where the operator put it, and it starts at once, as Start().
  /// @throws std::runtime_error with what is in doubt: at once on a robot and if a fault was not
  ///   cleared, with a simulator after 3 s.
  void Reset(std::uint64_t seed) override;
  [[nodiscard]] core::PlantStatus Apply(std::span<const double> control) noexcept override;
  void Observe(std::span<double> state) const noexcept override;
  [[nodiscard]] bool completed() const noexcept override;
  [[nodiscard]] bool collided() const noexcept override;
  /// The arm holds: the machine is idle where the task is completed, else holding. The loop goes on
  /// with Idle() only.
  void Halt() noexcept override;

  [[nodiscard]] runtime::RunState state() const noexcept;
  /// Whether it stands still for a reason that an episode may have: it was completed, or the
  /// controller halted it.
  [[nodiscard]] bool ended_regularly() const noexcept;
  /// Why it last stood still, in words.
  [[nodiscard]] std::string cause() const;
  /// What now keeps it from being started, in words.
  [[nodiscard]] std::string blocking() const;
  [[nodiscard]] const vision::LineObservation& last_observation() const noexcept;
  /// Which picture Observe() was taken from.
  [[nodiscard]] std::uint64_t image_sequence() const noexcept;
  [[nodiscard]] std::int64_t image_time_ns() const noexcept;
  [[nodiscard]] double progress_m() const noexcept;
  [[nodiscard]] LoopTimes loop_times() const noexcept;
  /// Called for each transition, by the loop: for the operator's screen.
  std::function<void(const runtime::Transition&)> on_transition;
  /// Where a signal handler says that the operator wants it to stop; may be nullptr.
  const std::atomic<bool>* interrupted = nullptr;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::apps::line_tracking
