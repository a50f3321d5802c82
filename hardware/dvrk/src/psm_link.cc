// Thread of a driver. Only this thread uses DDS.
#include "psm_link.h"

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <tuple>

#include "dfr/core/text/format.h"
#include "dfr/hardware/control_statement.h"
#include "dfr/runtime/periodic_timer.h"

namespace dfr::hardware {
namespace {

using dds::Role;
using internal::Outgoing;
using internal::Who;

constexpr long kPollNs = 1'000'000;
constexpr int kPollsPerCount = 10;
constexpr std::int64_t kLastNs = 2'000'000'000;  // time limit for stopping the arm at the end
constexpr double kLastWordsS = 1.0;              // enough for ten requests for a lost sample

Who InWords(const dds::Newcomer& newcomer) {
  Who who;
  const std::string text = dds::Describe(newcomer);
  std::memcpy(who.text.data(), text.data(), std::min(text.size(), who.text.size() - 1));
  return who;
}

bool ContainsAny(std::string_view text, std::initializer_list<std::string_view> parts) {
  return std::ranges::any_of(
      parts, [&](std::string_view part) { return text.find(part) != std::string_view::npos; });
}

PsmConsoleState StateOf(const std::string& text) {
  for (const PsmConsoleState state : {PsmConsoleState::kDisabled, PsmConsoleState::kEnabled,
                                      PsmConsoleState::kPaused, PsmConsoleState::kFault}) {
    if (text == Name(state)) return state;
  }
  return PsmConsoleState::kUnknown;
}

PsmJointSample Joints(const dds::JointState& message) {
  PsmJointSample sample;
  sample.stamp = message.stamp;
  sample.well_formed = message.position.size() == 6;
  sample.has_velocity = message.velocity.size() == 6;
  if (sample.well_formed) {
    sample.position = Eigen::Map<const kinematics::PsmJoints>(message.position.data());
  }
  if (sample.has_velocity) {
    sample.velocity = Eigen::Map<const kinematics::PsmJoints>(message.velocity.data());
  }
  return sample;
}

}  // namespace

PsmDriver::Link::Link(dds::Participant& participant, const PsmDriverOptions& options)
    : p(participant),
      arm(options.arm),
      is_si(options.client.limits.generation == kinematics::PsmGeneration::kSi) {
  const std::vector<std::string> usual = {"/console/teleop/enabled", "/MTML_" + arm + "/following",
                                          "/MTMR_" + arm + "/following"};
  for (const std::string& topic : options.teleoperation.empty() ? usual : options.teleoperation) {
    // A console keeps its last messages for late joiners, but other programs need not.
    for (const Role role : {Role::kEvent, Role::kRequest}) {
      teleoperations.push_back(std::make_unique<dds::Subscriber<dds::Flag>>(p, topic, role));
      teleoperated.push_back(false);
    }
  }
  if (options.servo_cs) {
    servo_cs =
        std::make_unique<dds::Publisher<dds::CartesianState>>(p, Topic("servo_cs"), Role::kCommand);
  }
  Subscribe<dds::PoseStamped>({"servo_cr", "move_cp", "move_cr", "set_base_frame"});
  Subscribe<dds::JointState>({"servo_jp", "servo_jr", "servo_jv", "servo_jf", "move_jp", "move_jr",
                              "jaw/servo_jp", "jaw/servo_jf", "jaw/move_jp"});
  Subscribe<dds::TwistStamped>({"servo_cv"});
  Subscribe<dds::WrenchStamped>({"servo_cf", "body/servo_cf", "spatial/servo_cf"});
  Subscribe<dds::Flag>({"use_gravity_compensation", "body/set_cf_orientation_absolute",
                        "emulate_tool_present", "emulate_adapter_present"});
  Subscribe<dds::Number>(
      {"trajectory_j/set_ratio", "trajectory_j/set_ratio_v", "trajectory_j/set_ratio_a"});
  Subscribe<dds::Text>({"set_tool_type"});
  ::sem_init(&wake, 0, 0);
  pose.frame_id = arm + "_base";
  jaw.name = {"jaw"};
  jaw.position = {0.0};
  thread = std::thread([this] { Run(); });
}

PsmDriver::Link::~Link() {
  stop.store(true, std::memory_order_release);
  ::sem_post(&wake);
  thread.join();
  ::sem_destroy(&wake);
}

void PsmDriver::Link::Run() noexcept {
  std::int64_t end_ns = 0;
  for (int poll = 0;; ++poll) {
    const bool stopping = stop.load(std::memory_order_acquire);
    if (stopping && end_ns == 0) end_ns = runtime::SteadyNow() + kLastNs;
    const std::uint64_t wanted = cycle_wanted.load(std::memory_order_acquire);
    const bool flushing = wanted != cycle_done.load(std::memory_order_relaxed);
    const bool requested = Send();
    if (flushing && requested) WaitForRequests(runtime::SteadyNow() + kLastNs);
    Receive();
    ReadMonitors();
    if (flushing || poll % kPollsPerCount == 0) Count();
    if (flushing) {
      cycle_done.store(wanted, std::memory_order_release);
      cycle_done.notify_all();
    }
    // Half of the time is for writing, the other half for the console's receipt.
    if (stopping && (!(hold_wanted.wanted() || disable_wanted.wanted()) ||
                     runtime::SteadyNow() > end_ns - kLastNs / 2)) {
      break;
    }
    timespec until{};
    ::clock_gettime(CLOCK_MONOTONIC, &until);
    until.tv_nsec += kPollNs;
    if (until.tv_nsec >= 1'000'000'000) {
      until.tv_nsec -= 1'000'000'000;
      ++until.tv_sec;
    }
    (void)::sem_clockwait(&wake, CLOCK_MONOTONIC, &until);
    while (::sem_trywait(&wake) == 0) {
    }
  }
  // Destroying a publisher discards samples that the console has not yet received.
  WaitForRequests(end_ns);
}

void PsmDriver::Link::WaitForRequests(std::int64_t end_ns) noexcept {
  const auto left_s = [end_ns] {
    return std::clamp(1e-9 * static_cast<double>(end_ns - runtime::SteadyNow()), 0.0, kLastWordsS);
  };
  (void)state_command.WaitUntilReceived(left_s());
  (void)hold.WaitUntilReceived(left_s());
}

bool PsmDriver::Link::Send() noexcept {
  // The hold is read before the set-points, so set-points queued before the hold are not sent.
  bool holding = hold_wanted.wanted();
  Outgoing next;
  bool servo = false;
  bool servo_jaw = false;
  bool requested = holding;
  // Sends only the last of several pending set-points.
  while (outbox.Take(next)) {
    if (next.servo) {
      servo = true;
      pose.stamp = next.stamp;
      pose.position_m = next.position_m;
      pose.orientation = next.orientation;
      twist = next.twist;
    }
    if (next.servo_jaw) {
      servo_jaw = true;
      jaw.stamp = next.stamp;
      jaw.position[0] = next.jaw;
    }
    if (next.request != PsmRequest::kNone) {
      requested = true;
      // The hold precedes the request, even if both were queued after the check above.
      holding = holding || hold_wanted.wanted();
      (void)hold_wanted.Send([this] { return hold.Write({}); });
      // No request overtakes a `disable` that is still to be sent.
      const bool disables = next.request == PsmRequest::kDisable;
      const bool written =
          (disables || !disable_wanted.wanted()) && WriteRequest(next.request, next.stamp);
      if (disables && !written) disable_wanted.Want();
      if (!written) failed.store(true, std::memory_order_relaxed);
    }
  }
  if (disable_wanted.wanted()) {
    requested = true;
    (void)disable_wanted.Send(
        [this] { return WriteRequest(PsmRequest::kDisable, dds::Stamp::Now()); });
  }
  if (holding) {
    (void)hold_wanted.Send([this] { return hold.Write({}); });
    return requested;
  }
  if (servo && !WriteServo()) failed.store(true, std::memory_order_relaxed);
  if (servo_jaw && !jaw_servo_jp.Write(jaw)) failed.store(true, std::memory_order_relaxed);
  sent.fetch_add((servo ? 1U : 0U) + (servo_jaw ? 1U : 0U), std::memory_order_release);
  return requested;
}

bool PsmDriver::Link::WriteRequest(PsmRequest request, const dds::Stamp& stamp) noexcept {
  dds::StringStamped command;
  command.stamp = stamp;
  command.text = Name(request);
  return state_command.Write(command);
}

bool PsmDriver::Link::WriteServo() noexcept {
  if (!sends_state) return servo_cp.Write(pose);
  dds::CartesianState state;
  state.stamp = pose.stamp;
  state.pose_valid = state.twist_valid = true;
  state.position_m = pose.position_m;
  state.orientation = pose.orientation;
  state.linear_m_s = twist.head<3>();
  state.angular_rad_s = twist.tail<3>();
  return servo_cs->Write(state);
}

void PsmDriver::Link::NoteControl(const ConsoleMessage& message) noexcept {
  const PsmControl control = ControlStatedBy(message.view());
  if (control == PsmControl::kPoses) pose_controls.fetch_add(1, std::memory_order_acq_rel);
  if (control != PsmControl::kOther) return;
  Who who;
  std::memcpy(who.text.data(), message.text.data(), who.text.size() - 1);
  new_control.Put(who);
  other_controls.fetch_add(1, std::memory_order_acq_rel);
}

void PsmDriver::Link::Receive() noexcept {
  // Reads messages first, so the reason for a FAULT is known when the FAULT is reported.
  const std::int64_t now_ns = tick_ns.load(std::memory_order_relaxed);
  std::uint64_t left_out = 0;
  for (const auto& [subscriber, severity, limit] :
       {std::tuple{&error, ConsoleMessage::Severity::kError, &error_limit},
        std::tuple{&warning, ConsoleMessage::Severity::kWarning, &warning_limit},
        std::tuple{&status, ConsoleMessage::Severity::kStatus, &status_limit}}) {
    while (subscriber->Take(text)) {
      ConsoleMessage message;
      message.severity = severity;
      const std::size_t size = std::min(text.text.size(), message.text.size() - 1);
      std::memcpy(message.text.data(), text.text.data(), size);
      core::MakePrintable({message.text.data(), size});
      if (severity == ConsoleMessage::Severity::kStatus) NoteControl(message);
      if (limit->Passes(now_ns)) messages.Put(message);
      if (severity == ConsoleMessage::Severity::kError) {
        new_error.Put(message);
        num_errors.fetch_add(1, std::memory_order_acq_rel);
      }
    }
    left_out += limit->TakeLeftOut(now_ns);
  }
  if (left_out > 0) {
    ConsoleMessage message;
    message.severity = ConsoleMessage::Severity::kWarning;
    std::snprintf(message.text.data(), message.text.size(), "%llu more messages were suppressed",
                  static_cast<unsigned long long>(left_out));
    messages.Put(message);
  }
  while (operating_state.Take(operating)) {
    PsmOperatingState state;
    state.state = StateOf(operating.state);
    state.homed = operating.is_homed;
    state.busy = operating.is_busy;
    const PsmStatus readiness = Readiness(state);
    if (readiness != PsmStatus::kOk) {
      ++lapses;
      last_lapse = readiness;
    }
    state.lapses = lapses;
    state.last_lapse = last_lapse;
    new_operating.Put(state);
  }
  if (measured_js.TakeNewest(joints)) new_measured_js.Put(Joints(joints));
  if (setpoint_js.TakeNewest(joints)) new_setpoint_js.Put(Joints(joints));
  if (measured_cp.TakeNewest(measured_pose)) {
    new_measured_cp.Put({measured_pose.stamp, measured_pose.position_m, measured_pose.orientation});
  }
  if (local_measured_cp.TakeNewest(measured_pose)) {
    new_local_cp.Put({measured_pose.stamp, measured_pose.position_m, measured_pose.orientation});
  }
  if (jaw_measured_js.TakeNewest(joints) && joints.position.size() == 1) {
    new_jaw_measured.Put({joints.stamp, joints.position[0]});
  }
  if (jaw_setpoint_js.TakeNewest(joints) && joints.position.size() == 1) {
    new_jaw_setpoint.Put({joints.stamp, joints.position[0]});
  }
}

template <typename T>
bool PsmDriver::Link::HearsOthers(dds::Subscriber<T>& subscriber,
                                  const dds::Origin& ours) noexcept {
  bool others = false;
  T message;
  dds::Origin from;
  while (subscriber.Take(message, from)) {
    if (from == ours) continue;
    if (!others) new_who.Put(InWords(p.PublisherOf(from)));
    others = true;
  }
  return others;
}

void PsmDriver::Link::LookForNewcomers() noexcept {
  const std::uint64_t num = p.num_found();
  if (num == num_found) return;
  int count = 0;
  std::uint64_t last = num_found;
  for (const dds::Newcomer& newcomer : p.FoundAfter(num_found)) {
    // An entry that was overwritten before it was read may belong to any participant.
    const bool missed = newcomer.number > last + 1;
    last = newcomer.number;
    if (!newcomer.topic.empty() && !Commands(newcomer.topic) && !Requests(newcomer.topic) &&
        !missed) {
      continue;
    }
    if (count++ == 0) new_who.Put(InWords(newcomer));
  }
  num_found = std::max(num, last);
  if (count == 0) return;
  Count();
  newcomers.fetch_add(count, std::memory_order_acq_rel);
}

void PsmDriver::Link::ReadMonitors() noexcept {
  LookForNewcomers();
  dds::Flag reached;
  int goals = 0;
  while (goal_reached.Take(reached)) ++goals;
  if (goals > 0) goals_reached.fetch_add(goals, std::memory_order_acq_rel);
  const int spoken = (HearsOthers(watched_hold, hold.origin()) ? 1 : 0) +
                     (HearsOthers(watched_free, {}) ? 1 : 0) +
                     (HearsOthers(watched_state_command, state_command.origin()) ? 1 : 0);
  if (spoken > 0) foreign_messages.fetch_add(spoken, std::memory_order_acq_rel);
  // A state is void if its publishers have left. Each check follows the reading, because
  // otherwise the last state would remain.
  dds::Flag flag;
  bool any = false;
  for (std::size_t i = 0; i < teleoperations.size(); ++i) {
    while (teleoperations[i]->Take(flag)) {
      teleoperated[i] = flag.value;
      if (flag.value) was_teleoperated.store(true, std::memory_order_release);
    }
    if (teleoperated[i]) teleoperated[i] = teleoperations[i]->health().publishers > 0;
    any = any || teleoperated[i];
  }
  is_teleoperated.store(any, std::memory_order_release);
  for (const auto& [subscriber, pressed] :
       {std::pair{&arm_clutch, &arm_clutched}, std::pair{&manip_clutch, &manip_clutched}}) {
    while (subscriber->Take(joy)) {
      *pressed = !joy.buttons.empty() && joy.buttons[0] != 0;
      if (*pressed) was_clutched.store(true, std::memory_order_release);
    }
    if (*pressed) *pressed = subscriber->health().publishers > 0;
  }
  is_clutched.store(arm_clutched || manip_clutched, std::memory_order_release);
  while (tool_type.Take(text)) {
    if (!tool.empty() && text.text != tool) tool_changes.fetch_add(1, std::memory_order_acq_rel);
    tool = text.text;
    // The instruments 400006 and 420006 have the same kinematics, but only 420006 fits a da Vinci
    // Si.
    const bool known = tool.find("420006") != std::string::npos ||
                       (!is_si && tool.find("400006") != std::string::npos);
    instrument.store(known ? PsmInstrument::kSuitable : PsmInstrument::kOther,
                     std::memory_order_release);
  }
  // The name is void if its publisher has left; the next publisher names the instrument again.
  if (tool_type.health().publishers == 0) {
    tool.clear();
    instrument.store(PsmInstrument::kNotNamed, std::memory_order_release);
  }
}

template <typename T>
void PsmDriver::Link::Subscribe(std::initializer_list<const char*> topics) {
  for (const char* topic : topics) {
    watched.push_back(std::make_shared<dds::Subscriber<T>>(p, Topic(topic), Role::kState));
  }
}

std::string_view PsmDriver::Link::OfTheArm(std::string_view topic) const {
  if (!topic.starts_with('/') || !topic.substr(1).starts_with(arm)) return {};
  topic.remove_prefix(1 + arm.size());
  return topic.starts_with('/') ? topic : std::string_view();
}

bool PsmDriver::Link::Requests(std::string_view topic) const {
  const std::string_view name = OfTheArm(topic);
  return name == "/hold" || name == "/free" || name == "/state_command" ||
         ContainsAny(name, {"/set_", "/use_", "/emulate_"});
}

bool PsmDriver::Link::Commands(std::string_view topic) const {
  return ContainsAny(OfTheArm(topic), {"/servo_", "/move_", "/interpolate_"});
}

void PsmDriver::Link::Count() noexcept {
  const dds::Health state = measured_js.health();
  // A second publisher of any state, such as a replayed log, would mix its samples with the arm's.
  int most = state.publishers;
  for (const int others :
       {setpoint_js.health().publishers, measured_cp.health().publishers,
        local_measured_cp.health().publishers, jaw_setpoint_js.health().publishers,
        operating_state.health().publishers}) {
    if (others > 1) most = std::max(most, others);
  }
  state_publishers.store(most, std::memory_order_relaxed);
  incompatible.store(state.incompatible, std::memory_order_relaxed);
  // Excludes our own monitoring subscribers.
  command_subscribers.store(std::max(0, state_command.num_subscribers() - 1),
                            std::memory_order_relaxed);
  hold_subscribers.store(std::max(0, hold.num_subscribers() - 1), std::memory_order_relaxed);
  servo_subscribers.store(std::max(0, servo_cp.num_subscribers() - 1), std::memory_order_relaxed);
  sends_state = servo_cs && servo_cs->num_subscribers() > 0;
  // Excludes our own publisher.
  const int others = std::max(0, watched_servo_cp.health().publishers - 1);
  const int found =
      p.CountOthersPublishers([this](std::string_view topic) { return Commands(topic); });
  other_publishers.store(std::max(others, found), std::memory_order_relaxed);
}

}  // namespace dfr::hardware
