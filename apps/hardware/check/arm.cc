#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "check/check.h"
#include "check/findings.h"
#include "check/missing_arm.h"
#include "check/permit.h"
#include "dfr/core/numerics/quantile.h"
#include "dfr/dds/channel.h"
#include "dfr/dds/emergency_stop.h"
#include "dfr/hardware/psm_driver.h"

namespace dfr::apps::hardware_app {
namespace {

using hardware::PsmPhase;
using hardware::PsmStatus;

constexpr double kClockTolerance = 0.01;  // s, largest difference of two machines' clocks
constexpr double kLeastStateRate = 50.0;  // 1/s; the watchdog detects silence after 50 ms
constexpr double kTinyMove = 0.002;       // m of insertion
constexpr double kTinyMoveTime = 1.0;     // s
constexpr double kBringUpTime = 120.0;    // s

// An arm behind a console, over DDS.
class ConsoleArm final : public CheckedArm {
 public:
  ConsoleArm(dds::Participant& participant, const CheckOptions& options)
      : participant_(&participant),
        stop_datagrams_(options.stop_datagrams),
        arm_(options.arm),
        driver_(participant, {.arm = options.arm,
                              .client = {.limits = hardware::PsmLimits::Of(options.generation)}}),
        measured_js_(participant, Full("measured_js"), dds::Role::kState),
        measured_cp_(participant, Full("measured_cp"), dds::Role::kState),
        setpoint_js_(participant, Full("setpoint_js"), dds::Role::kState),
        jaw_(participant, Full("jaw/measured_js"), dds::Role::kState),
        operating_state_(participant, Full("operating_state"), dds::Role::kEvent),
        error_(participant, Full("error"), dds::Role::kEvent) {}

  void Tick(std::int64_t steady_ns, std::int64_t wall_ns) override {
    (void)driver_.Tick(steady_ns, wall_ns);
  }
  [[nodiscard]] const hardware::PsmClient& client() const override { return driver_.client(); }
  [[nodiscard]] bool TakeMessage(hardware::ConsoleMessage& message) override {
    return driver_.TakeMessage(message);
  }
  [[nodiscard]] std::string_view last_error() const override { return driver_.last_error(); }
  [[nodiscard]] int other_publishers() const override { return driver_.other_publishers(); }
  [[nodiscard]] int state_publishers() const override { return driver_.state_publishers(); }
  [[nodiscard]] int servo_subscribers() const override { return driver_.servo_subscribers(); }
  [[nodiscard]] int request_subscribers() const override { return driver_.request_subscribers(); }
  [[nodiscard]] std::array<Topic, 6> topics() const override {
    return {{{"measured_js", measured_js_.health(), true},
             {"measured_cp", measured_cp_.health(), true},
             {"setpoint_js", setpoint_js_.health(), true},
             {"operating_state", operating_state_.health(), true},
             {"jaw/measured_js", jaw_.health(), false},
             {"error", error_.health(), false}}};
  }
  [[nodiscard]] PsmStatus Arm() override { return driver_.Arm(); }
  [[nodiscard]] PsmStatus MoveTo(const kinematics::PsmJoints& goal, double duration_s) override {
    return driver_.MoveTo(goal, duration_s);
  }
  void Hold() override { driver_.Hold(); }
  void Flush() override { driver_.Flush(); }
  PsmStatus BringUp(double timeout_s, const std::function<void(std::string_view)>& say,
                    const std::function<bool()>& may_move) override {
    return hardware::BringUp(driver_, timeout_s, say, may_move);
  }
  // Listens from the first call on and ignores earlier presses.
  [[nodiscard]] StopLook Stop(std::int64_t steady_ns) override {
    if (!stop_) {
      stop_.emplace(*participant_, kStopSilence, dds::kEmergencyStopTopic, stop_datagrams_);
    }
    const dds::EmergencyStop found = stop_->Check(steady_ns);
    return {found, stop_->only_datagrams_silent()};
  }

 private:
  [[nodiscard]] std::string Full(const char* name) const { return "/" + arm_ + "/" + name; }

  dds::Participant* participant_;
  bool stop_datagrams_;
  std::string arm_;
  hardware::PsmDriver driver_;
  dds::Subscriber<dds::JointState> measured_js_;
  dds::Subscriber<dds::PoseStamped> measured_cp_;
  dds::Subscriber<dds::JointState> setpoint_js_;
  dds::Subscriber<dds::JointState> jaw_;
  dds::Subscriber<dds::OperatingState> operating_state_;
  dds::Subscriber<dds::Text> error_;
  std::optional<dds::EmergencyStopReceiver> stop_;
};

bool AllFound(const CheckedArm& arm) {
  const auto topics = arm.topics();
  return std::ranges::all_of(topics,
                             [](const auto& topic) { return topic.health.publishers > 0; }) &&
         arm.client().num_samples() > 0 && arm.request_subscribers() > 0 &&
         arm.servo_subscribers() > 0;
}

// Checks the publishers of the console's topics and their quality of service.
void ReportTopics(const CheckOptions& options, const CheckedArm& arm, DeviceReport& report) {
  int published = 0;
  for (const auto& [name, health, needed] : arm.topics()) {
    const std::string full = "/" + options.arm + "/" + name;
    if (health.publishers == 1) {
      ++published;
    } else if (health.publishers > 1) {
      Wrong(report,
            std::to_string(health.publishers) + " publishers on " + full +
                ": their samples are mixed",
            "end all consoles and simulators of this arm except one");
    } else if (health.incompatible > 0) {
      Wrong(report, "a publisher on " + full + " does not match (QoS)",
            "it must be reliable, and transient-local for operating_state and error");
    } else if (needed) {
      Wrong(report, "no program publishes " + full, "use a CRTK console, dVRK 2.0 or later");
    } else {
      Note(report, "no program publishes " + full,
           "the arm works without it; the driver reports less");
    }
  }
  if (published > 0) Ok(report, std::to_string(published) + " of the console's topics found");
}

void Tick(const CheckOptions& options, CheckedArm& arm) {
  arm.Tick(options.clock->SteadyNs(), options.clock->WallNs());
}

// Ticks for `seconds`, or until `done`.
template <typename Done>
void Listen(const CheckOptions& options, CheckedArm& arm, double seconds, const Done& done) {
  (void)Within(*options.clock, seconds, [&] {
    Tick(options, arm);
    hardware::ConsoleMessage message;
    while (arm.TakeMessage(message)) {
      Say(options, std::string("message from the console (") + hardware::Name(message.severity) +
                       "): " + std::string(message.view()));
    }
    return done();
  });
}

// Describes a status, with the console's last error if the console has failed.
std::string Words(PsmStatus status, const CheckedArm& arm) {
  std::string what = hardware::Name(status);
  const bool failed = status == PsmStatus::kConsoleFault || status == PsmStatus::kConsoleError;
  if (failed && !arm.last_error().empty()) what += ": \"" + std::string(arm.last_error()) + "\"";
  return what;
}

void ReportMeasurements(DeviceReport& report, const hardware::PsmClient& client, double rate,
                        std::vector<double>& ages) {
  if (rate < kLeastStateRate) {
    Wrong(report, "measured_js arrives " + Text(rate, 0) + " times a second",
          "a console publishes 100 times a second; below " + Text(kLeastStateRate, 0) +
              " the driver treats it as silent: check the console's period and the network");
  } else {
    Ok(report, "measured_js arrives " + Text(rate, 0) + " times a second");
  }
  const hardware::PsmJointSample& js = client.measured_js();
  if (!js.well_formed) {
    Wrong(report, hardware::Name(PsmStatus::kStateMalformed),
          hardware::Remedy(PsmStatus::kStateMalformed));
  } else if (!js.position.allFinite() || !client.measured_cp().position_m.allFinite()) {
    Wrong(report, hardware::Name(PsmStatus::kStateNotFinite),
          hardware::Remedy(PsmStatus::kStateNotFinite));
  }
  if (!js.stamp.valid()) {
    // An arm measures nothing before homing. Another check reports an arm that is not homed.
    if (client.operating_state().homed) {
      Wrong(report, "measurements are stamped zero though the arm is homed",
            hardware::Remedy(PsmStatus::kStateInvalid));
    }
    return;
  }
  if (ages.empty()) return;
  const double age = core::Median(ages);
  if (age < -kClockTolerance || age > client.options().watchdog.max_age_s) {
    Wrong(report,
          "the console's clock, or its samples, are " + Text(std::abs(age), 3) + " s " +
              (age < 0.0 ? "ahead of" : "behind") + " this machine's clock",
          "set both machines' clocks by NTP or PTP; samples may be 50 ms old at most");
  } else {
    Ok(report, "samples are " + Text(1e3 * age, 1) + " ms old on arrival");
  }
}

void MoveALittle(const CheckOptions& options, CheckedArm& arm, Permit& permit,
                 DeviceReport& report) {
  const PsmStatus armed = arm.client().phase() == PsmPhase::kArmed ? PsmStatus::kOk : arm.Arm();
  if (armed != PsmStatus::kOk) {
    Wrong(report, std::string("the arm cannot be moved: ") + hardware::Name(armed),
          hardware::Remedy(armed));
    return;
  }
  const kinematics::PsmJoints start = arm.client().setpoint();
  const double sign = start[2] > 0.12 ? -1.0 : 1.0;
  kinematics::PsmJoints there = start;
  there[2] += sign * kTinyMove;
  const kinematics::PsmJoints from = arm.client().measured_js().position;
  kinematics::PsmJoints reached = from;
  for (const kinematics::PsmJoints& goal : {there, start}) {
    Tick(options, arm);
    const PsmStatus status = arm.MoveTo(goal, kTinyMoveTime);
    if (status != PsmStatus::kOk) {
      Wrong(report, std::string("a move of 2 mm is refused: ") + hardware::Name(status),
            status == PsmStatus::kBeyondLimits
                ? "move the arm away from its limits at the console; for an Si arm, give "
                  "--generation Si"
                : hardware::Remedy(status));
      break;
    }
    Listen(options, arm, 10.0, [&] {
      if (!permit.MayMove()) arm.Hold();
      return arm.client().at_rest() || arm.client().phase() != PsmPhase::kArmed;
    });
    if (!permit.MayMove()) {
      permit.Tell(report);
      break;
    }
    if (arm.client().phase() != PsmPhase::kArmed || !arm.client().at_rest()) {
      Wrong(report, "while moving by 2 mm: " + Words(arm.client().status(), arm),
            hardware::Remedy(arm.client().status()));
      break;
    }
    if (goal == there) reached = arm.client().measured_js().position;
  }
  const double moved = 1e3 * sign * (reached[2] - from[2]);
  if (arm.client().phase() == PsmPhase::kArmed) {
    if (std::abs(moved - 1e3 * kTinyMove) < 1.0) {
      Ok(report, "told to insert by " + Text(1e3 * sign * kTinyMove, 1) + " mm, the arm moved " +
                     Text(sign * moved, 2) + " mm, and came back");
    } else {
      Wrong(report,
            "told to move its instrument by 2 mm along the shaft, the arm measured " +
                Text(moved, 2) + " mm",
            "check whether another program holds the arm or the instrument is stuck");
    }
  }
  arm.Hold();
  Tick(options, arm);
  arm.Flush();
}

// Checks the console's data for options.listen_s, and looks for other publishers. Returns the final
// state of the emergency stop.
dds::EmergencyStop ListenToArm(const CheckOptions& options, CheckedArm& arm, DeviceReport& report) {
  Say(options, "listening for " + Text(options.listen_s, 0) + " s");
  const std::int64_t start_ns = options.clock->SteadyNs();
  const std::uint64_t first = arm.client().num_samples();
  std::uint64_t last = first;
  std::vector<double> ages;
  auto stop = dds::EmergencyStop::kSilent;
  Listen(options, arm, options.listen_s, [&] {
    stop = arm.Stop(options.clock->SteadyNs()).state;
    if (arm.client().num_samples() != last) {
      last = arm.client().num_samples();
      if (arm.client().measured_js().stamp.valid()) ages.push_back(arm.client().age_s());
    }
    return Interrupted(options);
  });
  if (Interrupted(options)) return stop;
  const double listened = 1e-9 * static_cast<double>(options.clock->SteadyNs() - start_ns);
  ReportTopics(options, arm, report);
  ReportMeasurements(report, arm.client(), static_cast<double>(last - first) / listened, ages);
  if (arm.request_subscribers() == 0 || arm.servo_subscribers() == 0) {
    Wrong(report,
          std::string("no program subscribes to ") +
              (arm.request_subscribers() == 0 ? "state_command" : "servo_cp"),
          "start the console, which subscribes to both; a monitor does not");
  } else {
    Ok(report, "the console subscribes to state_command and servo_cp");
  }
  if (arm.other_publishers() > 0) {
    Wrong(report, hardware::Name(PsmStatus::kOtherPublisher),
          hardware::Remedy(PsmStatus::kOtherPublisher));
  }
  return stop;
}

// Checks that the arm can be armed, after homing it on request.
PsmStatus CheckReady(const CheckOptions& options, CheckedArm& arm, Permit& permit,
                     DeviceReport& report) {
  PsmStatus status = arm.client().Armable();
  if ((status == PsmStatus::kDisabled || status == PsmStatus::kNotHomed) && options.home &&
      Ask(options, options.arm + " will move while it homes. Is it clear of people and objects?") &&
      permit.Granted(report, [&] { Tick(options, arm); })) {
    status = arm.BringUp(
        kBringUpTime, [&](std::string_view text) { Say(options, std::string(text)); },
        [&] { return permit.MayMove(); });
    if (!permit.MayMove()) {
      permit.Tell(report);
      return PsmStatus::kHeld;
    }
  }
  if (status == PsmStatus::kOk) {
    Ok(report,
       "ENABLED and homed; measured_cp agrees with measured_js for a Large Needle "
       "Driver");
  } else if (status != PsmStatus::kOtherPublisher) {
    const bool homes = status == PsmStatus::kDisabled || status == PsmStatus::kNotHomed;
    Wrong(
        report, Words(status, arm),
        homes ? "home it at the console, or run this check with --home" : hardware::Remedy(status));
  }
  return status;
}

// Returns true if no measurement of the arm was ever published.
bool IsMissing(const CheckedArm& arm) {
  return arm.client().num_samples() == 0 && arm.state_publishers() == 0 &&
         arm.client().status() != PsmStatus::kIncompatible;
}

}  // namespace

DeviceReport CheckArm(const CheckOptions& options, CheckedArm& arm) {
  DeviceReport report;
  report.device = options.arm + InNetwork(options);
  Say(options, "looking for " + options.arm);
  Listen(options, arm, options.find_s, [&] { return AllFound(arm) || Interrupted(options); });
  if (IsMissing(arm) && !Interrupted(options)) return report;
  const dds::EmergencyStop stop = ListenToArm(options, arm, report);
  if (Interrupted(options)) {
    Wrong(report, "interrupted", "");
    return report;
  }
  if (options.without_stop || stop == dds::EmergencyStop::kSilent) {
    // The missing emergency stop is reported first.
    report.findings.insert(
        report.findings.begin(),
        {Finding::Level::kNote,
         options.without_stop ? "WITHOUT AN EMERGENCY STOP: only the console can stop the arm"
                              : "NO EMERGENCY STOP was found: only the console can stop the arm",
         "run `hardware stop` in this domain, at the operator's hand"});
  }
  Permit permit(options, [&arm](std::int64_t steady_ns) { return arm.Stop(steady_ns); });
  const PsmStatus status = CheckReady(options, arm, permit, report);
  if (options.move && status == PsmStatus::kOk &&
      Ask(options,
          options.arm +
              " will move its instrument by 2 mm along the shaft and back. Is it clear?") &&
      permit.Granted(report, [&] { Tick(options, arm); })) {
    MoveALittle(options, arm, permit, report);
  }
  return report;
}

DeviceReport CheckArm(const CheckOptions& options) {
  dds::Participant participant(options.network);
  ConsoleArm arm(participant, options);
  DeviceReport report = CheckArm(options, arm);
  if (IsMissing(arm) && !Interrupted(options)) {
    ExplainMissing(options, participant, report);
  }
  return report;
}

}  // namespace dfr::apps::hardware_app
