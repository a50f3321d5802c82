#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/dds/participant.h"
#include "dfr/hardware/psm_client.h"

namespace dfr::hardware {

/// A message from the console's topics error, warning and status.
struct ConsoleMessage {
  enum class Severity { kError, kWarning, kStatus };
  Severity severity = Severity::kStatus;
  /// Zero-terminated; longer text is truncated. Control characters become question marks.
  std::array<char, 256> text{};

  [[nodiscard]] std::string_view view() const noexcept { return text.data(); }
};

[[nodiscard]] const char* Name(ConsoleMessage::Severity severity) noexcept;

/// Options for PsmDriver.
struct PsmDriverOptions {
  std::string arm = "PSM1";  ///< First part of the topic names.
  /// Topics (std_msgs/Bool) that are true while the arm may be teleoperated. Empty:
  /// /console/teleop/enabled, and /MTML_ARM/following and /MTMR_ARM/following with the arm's name.
  std::vector<std::string> teleoperation = {};
  /// Sends set-points on servo_cs, with their twist, while the console subscribes to it (dVRK 2.4),
  /// otherwise on servo_cp.
  bool servo_cs = false;
  PsmClientOptions client = {};
};

/// A patient-side manipulator behind a da Vinci Research Kit console (CRTK over ROS 2, or
/// dvrk_simulator): a PsmClient connected to the topics
///
///   subscribes  measured_js setpoint_js measured_cp local/measured_cp jaw/measured_js
///               jaw/setpoint_js operating_state error warning status tool_type arm_clutch
///               manip_clutch
///   publishes   servo_cp or servo_cs, jaw/servo_jp hold state_command
///
/// It also monitors others that command the arm: publishers on all servo_, move_ and interpolate_
/// topics of the arm, jaw and body, new publishers on its set_, use_ and emulate_ topics, messages
/// on hold, free and state_command, new participants, teleoperation, and moves ended by the console
/// (goal_reached), which this driver never starts. The console may receive a newcomer's messages
/// before this driver does, so the presence of a newcomer counts as a message. The console's
/// statements on `status` reveal commands that only the console has received.
///
/// A separate thread handles DDS, which allocates, locks and may wait. Lock-free mailboxes pass
/// messages. All members marked noexcept, in particular Tick(), therefore neither allocate, lock
/// nor wait. They belong to one thread at a time. The driver must be destroyed before the
/// participant. The destructor of an armed driver tells the console to hold. If the arm is homing,
/// it also tells the console to disable. It waits at most 2 s until the console has received this.
///
/// A new driver only listens. Usual order: Home(), Arm(), MoveTo(), ..., with Tick() throughout.
class PsmDriver {
 public:
  /// @throws std::invalid_argument naming the option that is out of range; std::runtime_error if
  ///   DDS refuses a topic.
  PsmDriver(dds::Participant& participant, const PsmDriverOptions& options);
  ~PsmDriver();
  PsmDriver(const PsmDriver&) = delete;
  PsmDriver& operator=(const PsmDriver&) = delete;

  /// Runs one step, at 200 Hz or more: processes and checks input, and sends the next set-point or
  /// hold. Returns status().
  /// @param steady_ns  time of a monotonic clock.
  /// @param wall_ns  time since the epoch, as in stamps.
  PsmStatus Tick(std::int64_t steady_ns, std::int64_t wall_ns) noexcept;
  /// Overload by this machine's clocks.
  PsmStatus Tick() noexcept;

  /// See the members of PsmClient.
  PsmStatus Request(PsmRequest request) noexcept { return client_.Request(request); }
  PsmStatus Home() noexcept { return client_.Request(PsmRequest::kHome); }
  PsmStatus Arm() noexcept { return client_.Arm(); }
  PsmStatus MoveTo(const kinematics::PsmJoints& goal, double duration_s) noexcept {
    return client_.MoveTo(goal, duration_s);
  }
  PsmStatus MoveJaw(double angle, double duration_s) noexcept {
    return client_.MoveJaw(angle, duration_s);
  }
  void Hold() noexcept { client_.Hold(); }

  [[nodiscard]] const PsmClient& client() const noexcept { return client_; }
  [[nodiscard]] PsmPhase phase() const noexcept { return client_.phase(); }
  [[nodiscard]] PsmStatus status() const noexcept { return client_.status(); }
  [[nodiscard]] bool moving() const noexcept { return client_.moving(); }
  [[nodiscard]] bool at_rest() const noexcept { return client_.at_rest(); }
  [[nodiscard]] const std::string& arm() const noexcept { return arm_; }

  /// Takes the oldest unread console message. Returns false if there is none. Passes at most five
  /// messages per severity in a second of Tick()'s clock; a warning states how many were
  /// suppressed. The queue holds 64 messages; further ones are lost.
  bool TakeMessage(ConsoleMessage& message) noexcept;
  /// Returns the last error reported by the console; empty if none.
  [[nodiscard]] std::string_view last_error() const noexcept { return last_error_.view(); }
  /// Describes the last participant that joined, sent a request or published a command, with
  /// address and topic. While the arm holds because of others, describes the first that caused the
  /// hold, or quotes the console if only the console has received the message. May be empty.
  [[nodiscard]] std::string_view who() const noexcept { return who_.data(); }
  /// True if who() is the cause of the hold.
  [[nodiscard]] bool held_by_others() const noexcept;
  /// Returns the participants that can tell the arm to hold, be free or change its state or
  /// settings. Allocates.
  [[nodiscard]] std::vector<dds::Newcomer> Requesters() const;
  /// Describes status() in a sentence, with the console's last error or who() if applicable, and
  /// the remedy. Allocates.
  [[nodiscard]] std::string Explain() const;

  /// Returns the numbers of other publishers on the arm's command topics, and of publishers of its
  /// state (see PsmInput::state_publishers), as of the last Tick().
  [[nodiscard]] int other_publishers() const noexcept { return other_publishers_; }
  [[nodiscard]] int state_publishers() const noexcept { return state_publishers_; }
  /// Return the numbers of subscribers to servo_cp, state_command and hold.
  [[nodiscard]] int servo_subscribers() const noexcept { return servo_subscribers_; }
  [[nodiscard]] int request_subscribers() const noexcept { return request_subscribers_; }
  [[nodiscard]] int hold_subscribers() const noexcept { return hold_subscribers_; }

  /// Returns the number of set-points sent, including the jaw's. After Flush() it includes all
  /// queued set-points.
  [[nodiscard]] std::uint64_t setpoints_sent() const noexcept;
  /// Waits until all queued output is sent and its requests are received, for 2 s at most, and
  /// until all input that arrived before the call is available to the next Tick(). Blocks: use it
  /// in lock-step only.
  void Flush();

 private:
  struct Link;
  std::string arm_;
  PsmClient client_;
  ConsoleMessage last_error_;
  std::array<char, 160> who_{};
  // The console's last statement that another command controls the arm.
  std::array<char, 160> control_{};
  int other_publishers_ = 0;
  int state_publishers_ = 0;
  int servo_subscribers_ = 0;
  int request_subscribers_ = 0;
  int hold_subscribers_ = 0;
  std::unique_ptr<Link> link_;
};

/// Clocks used by BringUp().
struct BringUpClock {
  std::function<std::int64_t()> steady_ns;  ///< Returns the monotonic time.
  std::function<std::int64_t()> wall_ns;    ///< Returns the time since the epoch, as in stamps.
  std::function<void()> wait;               ///< Waits until the next tick is due.

  /// Returns this machine's clocks, with a tick every 5 ms.
  [[nodiscard]] static BringUpClock Machine();
};

/// Homes the arm if necessary and arms it, ticking throughout, at the start of a program. Returns
/// kOk once the arm is armed, or the reason why it is not, after `timeout_s` at the latest. If the
/// arm is still homing then, tells the console to hold and to disable, and returns kTimedOut.
/// @param say  called with each console message and each reason for waiting; may be empty.
/// @param may_move  called before each tick, to check an emergency stop or Ctrl-C. If it returns
///   false, BringUp() tells the console to hold, and to disable a homing arm, and returns kHeld.
///   May be empty.
PsmStatus BringUp(PsmDriver& driver, double timeout_s,
                  const std::function<void(std::string_view)>& say = {},
                  const std::function<bool()>& may_move = {},
                  const BringUpClock& clock = BringUpClock::Machine());

}  // namespace dfr::hardware
