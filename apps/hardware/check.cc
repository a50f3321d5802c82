#include "check.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>

#include "dfr/core/error.h"
#include "dfr/core/format.h"
#include "dfr/core/quantile.h"
#include "dfr/dds/channel.h"
#include "dfr/dds/emergency_stop.h"
#include "dfr/hardware/endoscope.h"
#include "dfr/hardware/intrinsics_file.h"
#include "dfr/hardware/psm_driver.h"
#include "dfr/hardware/sprk_driver.h"

namespace dfr::apps::hardware_app {
namespace {

using hardware::FrameStatus;
using hardware::PsmPhase;
using hardware::PsmStatus;

constexpr double kClockTolerance = 0.01;  // s, largest difference of two machines' clocks
constexpr double kLeastStateRate = 50.0;  // 1/s: the watchdog takes 50 ms for silence
constexpr double kTinyMove = 0.002;       // m of insertion
constexpr double kTinyMoveTime = 1.0;     // s
constexpr double kBringUpTime = 120.0;    // s

void Ok(DeviceReport& report, const std::string& what) {
  report.findings.push_back({Finding::Level::kOk, what, ""});
}
void Note(DeviceReport& report, const std::string& what, const std::string& remedy) {
  report.findings.push_back({Finding::Level::kNote, what, remedy});
}
void Wrong(DeviceReport& report, const std::string& what, const std::string& remedy) {
  report.findings.push_back({Finding::Level::kWrong, what, remedy});
}

std::string Text(double value, int digits) { return core::Format("%.*f", digits, value); }

const char* Name(dds::Discovery discovery) {
  switch (discovery) {
    case dds::Discovery::kLoopback:
      return "loopback";
    case dds::Discovery::kNetwork:
      return "network";
    case dds::Discovery::kServerClient:
    case dds::Discovery::kServer:
      return "server";
  }
  return "unknown";
}

const char* Word(Finding::Level level) {
  switch (level) {
    case Finding::Level::kOk:
      return "ok";
    case Finding::Level::kNote:
      return "note";
    case Finding::Level::kWrong:
      return "wrong";
  }
  return "unknown";
}

void Say(const CheckOptions& options, const std::string& text) {
  if (options.say) options.say(text);
}
bool Ask(const CheckOptions& options, const std::string& question) {
  return options.ask && options.ask(question);
}

// Other arms that publish on the network.
std::vector<std::string> OtherArms(const CheckOptions& options, double seconds) {
  dds::Participant participant(options.network);
  struct Candidate {
    std::string name;
    std::unique_ptr<dds::Subscriber<dds::JointState>> subscriber;
  };
  std::vector<Candidate> candidates;
  for (const char* name : {"PSM1", "PSM2", "PSM3", "ECM", "MTML", "MTMR"}) {
    if (name == options.arm) continue;
    candidates.push_back(
        {name, std::make_unique<dds::Subscriber<dds::JointState>>(
                   participant, std::string("/") + name + "/measured_js", dds::Role::kState)});
  }
  std::vector<std::string> found;
  (void)Within(*options.clock, seconds, [&] {
    found.clear();
    for (const Candidate& candidate : candidates) {
      if (candidate.subscriber->health().publishers > 0) found.push_back(candidate.name);
    }
    return !found.empty();
  });
  return found;
}

bool PublishedIn(const dds::ParticipantOptions& network, const std::string& topic, double seconds,
                 Clock& clock) {
  dds::Participant participant(network);
  const dds::Subscriber<dds::JointState> subscriber(participant, topic, dds::Role::kState);
  return Within(clock, seconds, [&] { return subscriber.health().publishers > 0; });
}

// Reports participants that security keeps from this one.
void ExplainRefused(const CheckOptions& options, const dds::Participant& participant,
                    DeviceReport& report) {
  for (const dds::RefusedPeer& peer : participant.refused_peers()) {
    Wrong(report, "'" + peer.name + "' is present, but not admitted: " + peer.reason,
          options.network.security.empty()
              ? "give --security with a folder of that network's `hardware certificates`"
              : "give both folders of the same `hardware certificates`");
  }
}

// Reports why no console was found: another domain, another kind of discovery, another arm.
void ExplainSilence(const CheckOptions& options, DeviceReport& report) {
  const std::string topic = "/" + options.arm + "/measured_js";
  const double seconds = std::min(options.find_s, 2.0);
  std::string remedy = "start the console (or dvrk_simulator); its ROS_DOMAIN_ID must be " +
                       std::to_string(options.network.domain) + " and its network reachable";
  for (const dds::Discovery other : {dds::Discovery::kNetwork, dds::Discovery::kLoopback}) {
    dds::ParticipantOptions network = options.network;
    if (other == network.discovery || network.discovery == dds::Discovery::kServerClient) continue;
    network.discovery = other;
    if (PublishedIn(network, topic, seconds, *options.clock)) {
      remedy = std::string("it is found with --discovery ") + Name(other) + ": give that option";
    }
  }
  const char* text = std::getenv("ROS_DOMAIN_ID");
  char* end = nullptr;
  const long domain = text == nullptr ? 0 : std::strtol(text, &end, 10);
  if (text != nullptr && end != text && domain != options.network.domain && domain >= 0 &&
      domain <= 232) {
    dds::ParticipantOptions network = options.network;
    network.domain = static_cast<int>(domain);
    if (PublishedIn(network, topic, seconds, *options.clock)) {
      remedy =
          "it is in domain " + std::string(text) + ", as ROS_DOMAIN_ID says: give --domain " + text;
    }
  }
  Say(options, "looking for other arms");
  const std::vector<std::string> others = OtherArms(options, seconds);
  if (!others.empty()) {
    remedy = "there is " + others.front();
    for (std::size_t i = 1; i < others.size(); ++i) remedy += ", " + others[i];
    remedy += ": give --arm, or configure the console for " + options.arm;
  }
  Wrong(report,
        "no program publishes " + topic + " in domain " + std::to_string(options.network.domain) +
            " (discovery: " + Name(options.network.discovery) + ")",
        remedy);
}

// The arm of a console over DDS.
class ConsoleArm final : public CheckedArm {
 public:
  ConsoleArm(dds::Participant& participant, const CheckOptions& options)
      : participant_(&participant),
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
  [[nodiscard]] dds::EmergencyStop Stop(std::int64_t steady_ns) override {
    if (!stop_) stop_.emplace(*participant_, 0.1);
    return stop_->Check(steady_ns);
  }

 private:
  [[nodiscard]] std::string Full(const char* name) const { return "/" + arm_ + "/" + name; }

  dds::Participant* participant_;
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
            "itmust be reliable, and transient-local for operating_state and error");
    } else if (needed) {
      Wrong(report, "no program publishes " + full, "is this a CRTK console, dVRK 2.0 or later?");
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
      Say(options, std::string("the console says (") + hardware::Name(message.severity) +
                       "): " + std::string(message.view()));
    }
    return done();
  });
}

// Describes a status, with the console's last error if it has failed.
std::string Words(PsmStatus status, const CheckedArm& arm) {
  std::string what = hardware::Name(status);
  const bool failed = status == PsmStatus::kConsoleFault || status == PsmStatus::kConsoleError;
  if (failed && !arm.last_error().empty()) what += ": \"" + std::string(arm.last_error()) + "\"";
  return what;
}

void ReportMeasurements(DeviceReport& report, const hardware::PsmClient& client, double rate,
                        std::vector<double>& ages) {
  if (rate < kLeastStateRate) {
    Wrong(report, "measured_js comes " + Text(rate, 0) + " times a second",
          "a console publishes 100 times a second; below " + Text(kLeastStateRate, 0) +
              " the driver takes it for silent: check the console's period and the network");
  } else {
    Ok(report, "measured_js comes " + Text(rate, 0) + " times a second");
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
    // An arm that is not homed measures nothing. Another check reports that.
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

// Decides whether the arm may be moved: the emergency stop is connected and released, and the user
// has not interrupted.
class Permit {
 public:
  Permit(const CheckOptions& options, CheckedArm& arm) : options_(&options), arm_(&arm) {}

  // Waits for the emergency stop. Returns false and reports the reason if the arm may not be moved.
  [[nodiscard]] bool Granted(DeviceReport& report) {
    Say(*options_, "looking for the emergency stop");
    (void)Within(*options_->clock, std::min(options_->find_s, 5.0), [&] {
      Tick(*options_, *arm_);
      return MayMove();
    });
    if (MayMove()) return true;
    Tell(report);
    return false;
  }
  [[nodiscard]] bool MayMove() {
    if (options_->interrupted != nullptr && *options_->interrupted) return false;
    if (options_->without_stop) return true;
    found_ = arm_->Stop(options_->clock->SteadyNs());
    return found_ == dds::EmergencyStop::kClear;
  }
  void Tell(DeviceReport& report) const {
    if (options_->interrupted != nullptr && *options_->interrupted) {
      Wrong(report, "interrupted: the arm was not moved further", "");
    } else if (found_ == dds::EmergencyStop::kPressed) {
      Wrong(report, "the emergency stop is pressed, or was pressed during the check",
            "release it, and run this check again");
    } else {
      Wrong(report, "no emergency stop was found, and the arm is not moved without one",
            "run `hardware stop` in this domain, or give --without-stop in a simulation");
    }
  }

 private:
  const CheckOptions* options_;
  CheckedArm* arm_;
  dds::EmergencyStop found_ = dds::EmergencyStop::kSilent;
};

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
                ? "lead the arm away from its limits at the console; for an Si arm, give "
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
      Wrong(report, "told to insert by 2 mm, the arm measured " + Text(moved, 2) + " mm",
            "does another program hold the arm, or is the instrument stuck?");
    }
  }
  arm.Hold();
  Tick(options, arm);
  arm.Flush();
}

// Checks the console's data over a while, and looks for other publishers. Reports the final state
// of the emergency stop.
dds::EmergencyStop ListenToArm(const CheckOptions& options, CheckedArm& arm, DeviceReport& report) {
  Say(options, "listening for " + Text(options.listen_s, 0) + " s");
  const std::int64_t start_ns = options.clock->SteadyNs();
  const std::uint64_t first = arm.client().num_samples();
  std::uint64_t last = first;
  std::vector<double> ages;
  auto stop = dds::EmergencyStop::kSilent;
  Listen(options, arm, options.listen_s, [&] {
    stop = arm.Stop(options.clock->SteadyNs());
    if (arm.client().num_samples() != last) {
      last = arm.client().num_samples();
      if (arm.client().measured_js().stamp.valid()) ages.push_back(arm.client().age_s());
    }
    return false;
  });
  const double listened = 1e-9 * static_cast<double>(options.clock->SteadyNs() - start_ns);
  ReportTopics(options, arm, report);
  ReportMeasurements(report, arm.client(), static_cast<double>(last - first) / listened, ages);
  if (arm.request_subscribers() == 0 || arm.servo_subscribers() == 0) {
    Wrong(report,
          std::string("no program subscribes to ") +
              (arm.request_subscribers() == 0 ? "state_command" : "servo_cp"),
          "is this only a monitor? a console subscribes to both");
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
      permit.Granted(report)) {
    (void)arm.BringUp(
        kBringUpTime, [&](std::string_view text) { Say(options, std::string(text)); },
        [&] { return permit.MayMove(); });
    if (!permit.MayMove()) permit.Tell(report);
    status = arm.client().phase() == PsmPhase::kArmed ? PsmStatus::kOk : arm.client().status();
  }
  if (status == PsmStatus::kOk) {
    Ok(report,
       "ENABLED and homed; measured_cp is where measured_js puts the wrist of a Large "
       "Needle Driver");
  } else if (status != PsmStatus::kOtherPublisher) {
    const bool homes = status == PsmStatus::kDisabled || status == PsmStatus::kNotHomed;
    Wrong(
        report, Words(status, arm),
        homes ? "home it at the console, or run this check with --home" : hardware::Remedy(status));
  }
  return status;
}

// No measurement of the arm was ever published.
bool IsMissing(const CheckedArm& arm) {
  return arm.client().num_samples() == 0 && arm.state_publishers() == 0 &&
         arm.client().status() != PsmStatus::kIncompatible;
}

// Pictures received from an endoscope in a while.
struct Pictures {
  std::array<int, static_cast<std::size_t>(FrameStatus::kFrozen) + 1> times{};  // by FrameStatus
  std::vector<double> ages;                                                     // s
  std::uint64_t received = 0;
  std::uint64_t lost = 0;
  double rate = 0.0;      // 1/s
  hardware::Frame frame;  // the last one

  [[nodiscard]] int good() const noexcept { return times[0]; }
};

Pictures ReceivePictures(const CheckOptions& options, hardware::Endoscope& endoscope) {
  Pictures pictures;
  hardware::Frame& frame = pictures.frame;
  Clock& clock = *options.clock;
  const auto grab = [&] { return endoscope.Grab(clock.SteadyNs(), clock.WallNs(), frame); };
  (void)Within(clock, options.find_s, [&] { return grab() != FrameStatus::kNever; });
  const std::int64_t start_ns = clock.SteadyNs();
  const hardware::EndoscopeCounts before = endoscope.counts();
  std::uint64_t last = 0;
  (void)Within(clock, options.listen_s, [&] {
    const FrameStatus status = grab();
    ++pictures.times[static_cast<std::size_t>(status)];
    if (frame.sequence != last) pictures.ages.push_back(frame.age_s);
    last = frame.sequence;
    return status == FrameStatus::kEnded || status == FrameStatus::kTruncated ||
           status == FrameStatus::kFailed;
  });
  const hardware::EndoscopeCounts after = endoscope.counts();
  const double seconds = 1e-9 * static_cast<double>(clock.SteadyNs() - start_ns);
  pictures.received = after.received - before.received;
  pictures.lost = after.lost - before.lost;
  pictures.rate = static_cast<double>(pictures.received) / seconds;
  return pictures;
}

// Reports the number of good pictures and the most frequent error of the others.
void ReportPictures(const CheckOptions& options, const hardware::EndoscopeOptions& camera,
                    const Pictures& pictures, DeviceReport& report) {
  const auto& [times, ages, received, lost, rate, frame] = pictures;
  const auto size = [](int width, int height) {
    return std::to_string(width) + " x " + std::to_string(height);
  };
  if (pictures.good() > 0) {
    Ok(report,
       Text(rate, 1) + " pictures a second of " + size(frame.width, frame.height) + " pixels");
  }
  const auto worst = std::max_element(times.begin() + 1, times.end());
  const int looks = std::max(1, *std::max_element(times.begin(), times.end()));
  const auto status = static_cast<FrameStatus>(worst - times.begin());
  const bool late = status == FrameStatus::kOld || status == FrameStatus::kSilent;
  if (*worst > 0 && status == FrameStatus::kEnded) {
    Note(report, hardware::Name(status), hardware::Remedy(status));
  } else if (late && 10 * *worst > looks && 2 * *worst <= looks) {
    Note(report, std::string("occasionally: ") + hardware::Name(status),
         "is the network, or the machine, overloaded?");
  } else if (10 * *worst > looks) {
    std::string what = hardware::Name(status);
    if (status == FrameStatus::kWrongSize) {
      what = "pictures have " + size(frame.width, frame.height) +
             " pixels, the intrinsics are for " + size(camera.width, camera.height);
    } else if (status == FrameStatus::kOld || status == FrameStatus::kAhead) {
      what += ": by " + Text(std::abs(frame.age_s), 3) + " s";
    } else if (status == FrameStatus::kNever) {
      what = "no program publishes pictures on " + options.endoscope;
    }
    Wrong(report, what, hardware::Remedy(status));
  }
}

nlohmann::json Json(const DeviceReport& report) {
  nlohmann::json findings = nlohmann::json::array();
  for (const Finding& finding : report.findings) {
    findings.push_back(
        {{"level", Word(finding.level)}, {"what", finding.what}, {"remedy", finding.remedy}});
  }
  return {{"device", report.device}, {"ok", report.ok()}, {"findings", findings}};
}

}  // namespace

bool DeviceReport::ok() const noexcept {
  return std::none_of(findings.begin(), findings.end(),
                      [](const Finding& f) { return f.level == Finding::Level::kWrong; });
}

DeviceReport CheckArm(const CheckOptions& options, CheckedArm& arm) {
  DeviceReport report;
  report.device = options.arm + " (DDS domain " + std::to_string(options.network.domain) +
                  ", discovery: " + Name(options.network.discovery) + ")";
  Say(options, "looking for " + options.arm);
  Listen(options, arm, options.find_s, [&] { return AllFound(arm); });
  if (IsMissing(arm)) return report;
  const dds::EmergencyStop stop = ListenToArm(options, arm, report);
  if (options.without_stop || stop == dds::EmergencyStop::kSilent) {
    // The missing emergency stop is reported first.
    report.findings.insert(
        report.findings.begin(),
        {Finding::Level::kNote,
         options.without_stop ? "WITHOUT AN EMERGENCY STOP: only the console can stop the arm"
                              : "NO EMERGENCY STOP was found: only the console can stop the arm",
         "run `hardware stop` in this domain, at the operator's hand"});
  }
  Permit permit(options, arm);
  const PsmStatus status = CheckReady(options, arm, permit, report);
  if (options.move && status == PsmStatus::kOk &&
      Ask(options,
          options.arm + " will insert its instrument by 2 mm and retract it. Is it clear?") &&
      permit.Granted(report)) {
    MoveALittle(options, arm, permit, report);
  }
  return report;
}

DeviceReport CheckArm(const CheckOptions& options) {
  dds::Participant participant(options.network);
  ConsoleArm arm(participant, options);
  DeviceReport report = CheckArm(options, arm);
  if (IsMissing(arm)) {
    ExplainRefused(options, participant, report);
    if (report.ok()) ExplainSilence(options, report);
  }
  return report;
}

DeviceReport CheckEndoscope(const CheckOptions& options) {
  DeviceReport report;
  report.device = "endoscope " + options.endoscope;
  hardware::EndoscopeOptions camera;
  if (!options.camera.empty()) {
    try {
      const vision::CameraModel model = hardware::ReadIntrinsics(options.camera);
      camera.width = model.width;
      camera.height = model.height;
      Ok(report, "intrinsics for " + std::to_string(model.width) + " x " +
                     std::to_string(model.height) + " pixels, focal length " + Text(model.fx, 1) +
                     " x " + Text(model.fy, 1) + " pixels");
    } catch (const std::runtime_error& e) {
      Wrong(report, e.what(), "calibrate the camera; see docs/robot.md");
      return report;
    }
  }
  std::unique_ptr<dds::Participant> participant;
  std::unique_ptr<hardware::Endoscope> endoscope;
  Say(options, "looking at " + options.endoscope);
  try {
    if (hardware::IsImageTopic(options.endoscope)) {
      participant = std::make_unique<dds::Participant>(options.network);
      report.device += " (DDS domain " + std::to_string(options.network.domain) +
                       ", discovery: " + Name(options.network.discovery) + ")";
      endoscope = hardware::OpenTopic(*participant, options.endoscope, camera);
    } else {
      endoscope = hardware::OpenVideo(options.endoscope, camera);
    }
  } catch (const core::Error& e) {
    Wrong(report, std::string(e.problem()), std::string(e.remedy()));
    return report;
  } catch (const std::runtime_error& e) {
    Wrong(report, e.what(), "");
    return report;
  }

  LookAt(options, camera, *endoscope, report);
  return report;
}

void LookAt(const CheckOptions& options, const hardware::EndoscopeOptions& camera,
            hardware::Endoscope& endoscope, DeviceReport& report) {
  Pictures pictures = ReceivePictures(options, endoscope);
  ReportPictures(options, camera, pictures, report);
  if (pictures.good() == 0 || pictures.ages.empty()) return;
  if (hardware::IsImageTopic(options.endoscope)) {
    Ok(report, "pictures are " + Text(1e3 * core::Median(pictures.ages), 1) + " ms old");
  }
  if (10 * pictures.lost > pictures.received) {
    Note(report, std::to_string(pictures.lost) + " pictures were lost",
         "is the network, or the machine, overloaded? send compressed pictures");
  }
}

DeviceReport CheckPlatform(const CheckOptions& options) {
  DeviceReport report;
  report.device = "platform at " + options.platform;
  try {
    hardware::SprkDriver driver({.device = options.platform, .clock_s = [&options] {
                                   return 1e-9 * static_cast<double>(options.clock->SteadyNs());
                                 }});
    Ok(report, "the port opens at 57600 8N1, and no other program uses it");
    Note(report,
         "the firmware never answers: only a motion shows whether the platform receives commands",
         "run this check with --move, and watch");
    if (options.move &&
        Ask(options, "the platform will go home and tilt by 3 degrees and back. Is it clear?")) {
      hardware::SprkStatus status = driver.Home();
      kinematics::PlatformPose tilted;
      tilted.angles_rad.x() = 3.0 * 0.017453292519943295;
      for (const kinematics::PlatformPose& pose : {tilted, kinematics::PlatformPose{}}) {
        options.clock->Wait(1.0);
        if (status == hardware::SprkStatus::kOk) status = driver.MoveTo(pose);
      }
      if (status != hardware::SprkStatus::kOk) {
        Wrong(report, std::string("the platform cannot be commanded: ") + hardware::Name(status),
              "is the cable in and the board powered?");
      } else {
        Ok(report,
           "was told to go home, tilt by 3 degrees and return: if it did not, switch its power off "
           "and on and plug it in again");
      }
    }
  } catch (const core::Error& e) {
    Wrong(report, std::string(e.problem()),
          e.remedy().empty() ? "is this the platform's port?" : std::string(e.remedy()));
  }
  return report;
}

void Print(const DeviceReport& report, std::ostream& out) {
  out << report.device << '\n';
  for (const Finding& finding : report.findings) {
    const std::string word = std::string("[") + Word(finding.level) + "]";
    out << "  " << word << std::string(8 - word.size(), ' ') << finding.what << '\n';
    if (!finding.remedy.empty()) out << "          -> " << finding.remedy << '\n';
  }
}

void PrintJson(const std::vector<DeviceReport>& reports, std::ostream& out) {
  nlohmann::json all;
  all["ok"] = std::all_of(reports.begin(), reports.end(),
                          [](const DeviceReport& report) { return report.ok(); });
  all["devices"] = nlohmann::json::array();
  for (const DeviceReport& report : reports) all["devices"].push_back(Json(report));
  out << all.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) << std::endl;
}

int RunCheck(CheckOptions options) {
  if (options.arm.empty() && options.endoscope.empty() && options.platform.empty()) {
    options.arm = "PSM1";
    options.endoscope = "/ECM/image_raw";
  }
  std::vector<DeviceReport> reports;
  const auto add = [&](DeviceReport report) {
    if (!options.json) Print(report, std::cout);
    std::cout.flush();
    reports.push_back(std::move(report));
  };
  if (!options.arm.empty()) add(CheckArm(options));
  if (!options.endoscope.empty()) add(CheckEndoscope(options));
  if (!options.platform.empty()) add(CheckPlatform(options));
  const bool ok = std::all_of(reports.begin(), reports.end(),
                              [](const DeviceReport& report) { return report.ok(); });
  if (options.json) {
    PrintJson(reports, std::cout);
  } else {
    std::cout << (ok ? "no errors" : "errors were found: see above") << std::endl;
  }
  return ok ? EXIT_SUCCESS : EXIT_FAILURE;
}

}  // namespace dfr::apps::hardware_app
