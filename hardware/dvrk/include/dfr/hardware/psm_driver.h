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

/// Something that the console said on its topics error, warning and status, in its own words.
struct ConsoleWord {
  enum class Severity { kError, kWarning, kStatus };
  Severity severity = Severity::kStatus;
  /// Ends with a zero; what is longer is cut off. Control characters are question marks.
  std::array<char, 256> text{};

  [[nodiscard]] std::string_view view() const noexcept { return text.data(); }
};

[[nodiscard]] const char* Name(ConsoleWord::Severity severity) noexcept;

/// Options for PsmDriver.
struct PsmDriverOptions {
  std::string arm = "PSM1";  ///< First part of the topics' names.
  /// Topics (std_msgs/Bool) that are true while the arm may be teleoperated. Empty:
  /// /console/teleop/enabled, and /MTML_ARM/following and /MTMR_ARM/following with the arm's name.
  std::vector<std::string> teleoperation = {};
  /// Set-points are sent on servo_cs, with their twist, while the console listens to it (dVRK 2.4),
  /// else on servo_cp.
  bool servo_cs = false;
  PsmClientOptions client = {};
};

/// A patient-side manipulator behind a da Vinci Research Kit console (CRTK over ROS 2, or
/// dvrk_simulator): a PsmClient with its ends of the topics
///   takes      measured_js setpoint_js measured_cp local/measured_cp jaw/measured_js
///              jaw/setpoint_js operating_state error warning status tool_type arm_clutch
///              manip_clutch
///   publishes  servo_cp or servo_cs, jaw/servo_jp hold state_command
/// and it looks who else publishes on any servo_, move_ or interpolate_ topic of the arm, jaw and
/// body included, what others say on hold, free and state_command, who joins the network, whether
/// the console ends a move (goal_reached), which is never ours, and whether a teleoperation is
/// enabled. The console may hear a newcomer before this driver does: that it is there counts as
/// much as a word of it.
///
/// A thread of its own talks to DDS, which allocates, locks and may wait; messages pass through
/// mailboxes without locks. So everything marked noexcept here, Tick() above all, neither allocates
/// nor locks nor waits. Those calls belong to one thread at a time. To be destroyed before the
/// participant; an armed driver tells the console to hold when it is destroyed, and one that homes
/// the arm to disable it as well.
///
/// A new driver only listens. Usual order: Home(), Arm(), MoveTo(), ..., with Tick() all along.
class PsmDriver {
 public:
  /// @throws std::invalid_argument naming the option that is out of range; std::runtime_error if
  ///   DDS refuses a topic.
  PsmDriver(dds::Participant& participant, const PsmDriverOptions& options);
  ~PsmDriver();
  PsmDriver(const PsmDriver&) = delete;
  PsmDriver& operator=(const PsmDriver&) = delete;

  /// One step, at 200 Hz or more: takes what has come, checks it, and sends the next set-point or
  /// hold. Returns status().
  /// @param steady_ns  a clock that never goes back.
  /// @param wall_ns  since the epoch, as stamps are.
  PsmStatus Tick(std::int64_t steady_ns, std::int64_t wall_ns) noexcept;
  /// By this machine's clocks.
  PsmStatus Tick() noexcept;

  /// See PsmClient for these.
  PsmStatus Request(PsmRequest request) noexcept { return client_.Request(request); }
  PsmStatus Enable() noexcept { return client_.Request(PsmRequest::kEnable); }
  PsmStatus Home() noexcept { return client_.Request(PsmRequest::kHome); }
  PsmStatus Arm() noexcept { return client_.Arm(); }
  PsmStatus MoveTo(const kinematics::PsmJoints& goal, double duration_s) noexcept {
    return client_.MoveTo(goal, duration_s);
  }
  PsmStatus MoveTo(const Eigen::Isometry3d& goal, double duration_s) noexcept {
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

  /// The oldest of the console's words that has not been taken. False if there is none. Of each
  /// severity five come in a second of Tick()'s clock, and a warning says how many more there were.
  /// Up to 64 wait; what comes then is lost.
  bool TakeWord(ConsoleWord& word) noexcept;
  /// The last error that the console reported, empty if none.
  [[nodiscard]] std::string_view last_error() const noexcept { return last_error_.view(); }
  /// Who published, spoke or joined last, in words, with address and topic: where the arm holds
  /// because of it, the first that it holds because of. Empty if nobody did.
  [[nodiscard]] std::string_view who() const noexcept { return who_.data(); }
  /// Whether that is why it holds.
  [[nodiscard]] bool held_by_others() const noexcept;
  /// Who else can tell the arm to hold, to be free or to change its state. Allocates.
  [[nodiscard]] std::vector<dds::Newcomer> Requesters() const;
  /// status() in a sentence, with the console's last error or with who() where that is the reason,
  /// and the remedy. Allocates.
  [[nodiscard]] std::string Explain() const;

  /// Publishers on the arm's command topics besides this driver, and on its measured_js, as of the
  /// last Tick().
  [[nodiscard]] int other_publishers() const noexcept { return other_publishers_; }
  [[nodiscard]] int state_publishers() const noexcept { return state_publishers_; }
  /// Who listens to servo_cp, and who to state_command.
  [[nodiscard]] int servo_subscribers() const noexcept { return servo_subscribers_; }
  [[nodiscard]] int request_subscribers() const noexcept { return request_subscribers_; }

  /// Set-points sent so far, the jaw's included. After Flush() all that were handed over count.
  [[nodiscard]] std::uint64_t setpoints_sent() const noexcept;
  /// Waits until all that was handed over has been sent, and all that had arrived before the call
  /// is there for the next Tick(). For lock-step; blocks, so not for a control loop.
  void Flush();

 private:
  struct Link;
  std::string arm_;
  PsmClient client_;
  ConsoleWord last_error_;
  std::array<char, 160> who_{};
  int other_publishers_ = 0;
  int state_publishers_ = 0;
  int servo_subscribers_ = 0;
  int request_subscribers_ = 0;
  std::unique_ptr<Link> link_;
};

/// What BringUp() ticks by.
struct BringUpClock {
  std::function<std::int64_t()> steady_ns;  ///< Never goes back.
  std::function<std::int64_t()> wall_ns;    ///< Since the epoch, as stamps are.
  std::function<void()> wait;               ///< Returns when the next tick is due.

  /// This machine's clocks, and a tick every 5 ms.
  [[nodiscard]] static BringUpClock Machine();
};

/// Homes (if need be) and arms, ticking all along: for programs' starts. Returns driver.status(),
/// kOk if armed; gives up after `timeout_s` with the reason.
/// @param say  called with each of the console's words and with what is waited for; may be empty.
/// @param may_move  asked before each tick: emergency stop, Ctrl-C. False ends it with kHeld and
///   tells the console to hold, and to disable an arm that homes. May be empty.
PsmStatus BringUp(PsmDriver& driver, double timeout_s,
                  const std::function<void(std::string_view)>& say = {},
                  const std::function<bool()>& may_move = {},
                  const BringUpClock& clock = BringUpClock::Machine());

}  // namespace dfr::hardware
