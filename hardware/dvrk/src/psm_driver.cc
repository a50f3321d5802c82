#include "dfr/hardware/psm_driver.h"

#include <semaphore.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <stdexcept>
#include <thread>
#include <tuple>

#include "dfr/core/contract.h"
#include "dfr/dds/channel.h"
#include "dfr/hardware/control_word.h"
#include "dfr/hardware/word_limit.h"
#include "dfr/runtime/latest.h"
#include "dfr/runtime/queue.h"

namespace dfr::hardware {
namespace {

using dds::Role;

constexpr long kPollNs = 1'000'000;
constexpr int kPollsPerCount = 10;
constexpr std::size_t kMostWords = 64;

// Description of the sender of a foreign message, truncated if necessary.
struct Who {
  std::array<char, 160> text{};
};

Who InWords(const dds::Newcomer& newcomer) {
  Who who;
  const std::string text = dds::Describe(newcomer);
  std::memcpy(who.text.data(), text.data(), std::min(text.size(), who.text.size() - 1));
  return who;
}

std::int64_t SteadyNs() noexcept {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
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

// Output of Step(), except the hold, which has a separate flag and is therefore never lost.
struct Outgoing {
  bool servo = false;
  bool servo_jaw = false;
  PsmRequest request = PsmRequest::kNone;
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
  Eigen::Matrix<double, 6, 1> twist = Eigen::Matrix<double, 6, 1>::Zero();
  double jaw = 0.0;
  dds::Stamp stamp;
};

}  // namespace

const char* Name(ConsoleWord::Severity severity) noexcept {
  switch (severity) {
    case ConsoleWord::Severity::kError:
      return "error";
    case ConsoleWord::Severity::kWarning:
      return "warning";
    case ConsoleWord::Severity::kStatus:
      return "status";
  }
  return "unknown";
}

// The DDS side: a thread that sends the contents of Tick()'s mailboxes and fills them with input.
// Only that thread uses publishers and subscribers.
struct PsmDriver::Link {  // NOLINT(clang-analyzer-optin.performance.Padding): by meaning
  Link(dds::Participant& participant, const PsmDriverOptions& options)
      : p(participant),
        arm(options.arm),
        is_si(options.client.limits.generation == kinematics::PsmGeneration::kSi) {
    const std::vector<std::string> usual = {
        "/console/teleop/enabled", "/MTML_" + arm + "/following", "/MTMR_" + arm + "/following"};
    for (const std::string& topic : options.teleoperation.empty() ? usual : options.teleoperation) {
      // A console keeps its last messages for late joiners; other programs may not.
      for (const Role role : {Role::kEvent, Role::kRequest}) {
        teleoperations.push_back(std::make_unique<dds::Subscriber<dds::Flag>>(p, topic, role));
        teleoperated.push_back(false);
      }
    }
    if (options.servo_cs) {
      servo_cs = std::make_unique<dds::Publisher<dds::CartesianState>>(p, Topic("servo_cs"),
                                                                       Role::kCommand);
    }
    ::sem_init(&wake, 0, 0);
    pose.frame_id = arm + "_base";
    jaw.name = {"jaw"};
    jaw.position = {0.0};
    thread = std::thread([this] { Run(); });
  }
  ~Link() {
    stop.store(true, std::memory_order_release);
    ::sem_post(&wake);
    thread.join();
    ::sem_destroy(&wake);
  }
  Link(const Link&) = delete;
  Link& operator=(const Link&) = delete;

  [[nodiscard]] std::string Topic(const char* name) const { return "/" + arm + "/" + name; }

  void Run() noexcept {
    for (int poll = 0;; ++poll) {
      const bool stopping = stop.load(std::memory_order_acquire);
      const std::uint64_t wanted = cycle_wanted.load(std::memory_order_acquire);
      const bool flushing = wanted != cycle_done.load(std::memory_order_relaxed);
      Send();
      Receive();
      Watch();
      if (flushing || poll % kPollsPerCount == 0) Count();
      if (flushing) {
        cycle_done.store(wanted, std::memory_order_release);
        cycle_done.notify_all();
      }
      if (stopping) return;
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
  }

  void Send() noexcept {
    // Read before the set-points, so set-points queued before the hold are not sent.
    const bool holding = hold_wanted.exchange(false, std::memory_order_acq_rel);
    Outgoing next;
    bool servo = false;
    bool servo_jaw = false;
    // Only the last of several pending set-points counts.
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
        if (holding) hold.Write({});
        dds::StringStamped command;
        command.stamp = next.stamp;
        command.text = Name(next.request);
        if (!state_command.Write(command)) failed.store(true, std::memory_order_relaxed);
      }
    }
    if (holding) {
      hold.Write({});
      return;
    }
    if (servo && !WriteServo()) failed.store(true, std::memory_order_relaxed);
    if (servo_jaw && !jaw_servo_jp.Write(jaw)) failed.store(true, std::memory_order_relaxed);
    sent.fetch_add((servo ? 1U : 0U) + (servo_jaw ? 1U : 0U), std::memory_order_release);
  }

  bool WriteServo() noexcept {
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

  void NoteControl(const ConsoleWord& word) noexcept {
    const PsmControl control = ControlStatedBy(word.view());
    if (control == PsmControl::kPoses) pose_controls.fetch_add(1, std::memory_order_acq_rel);
    if (control != PsmControl::kOther) return;
    Who who;
    std::memcpy(who.text.data(), word.text.data(), who.text.size() - 1);
    new_control.Put(who);
    other_controls.fetch_add(1, std::memory_order_acq_rel);
  }

  void Receive() noexcept {
    // Messages first, so the reason of a FAULT is known when it is reported.
    const std::int64_t now_ns = tick_ns.load(std::memory_order_relaxed);
    std::uint64_t left_out = 0;
    for (const auto& [subscriber, severity, limit] :
         {std::tuple{&error, ConsoleWord::Severity::kError, &error_limit},
          std::tuple{&warning, ConsoleWord::Severity::kWarning, &warning_limit},
          std::tuple{&status, ConsoleWord::Severity::kStatus, &status_limit}}) {
      while (subscriber->Take(text)) {
        ConsoleWord word;
        word.severity = severity;
        const std::size_t size = std::min(text.text.size(), word.text.size() - 1);
        std::memcpy(word.text.data(), text.text.data(), size);
        MakePrintable(word.text.data());
        if (severity == ConsoleWord::Severity::kStatus) NoteControl(word);
        if (limit->Passes(now_ns)) words.Put(word);
        if (severity == ConsoleWord::Severity::kError) {
          new_error.Put(word);
          num_errors.fetch_add(1, std::memory_order_acq_rel);
        }
      }
      left_out += limit->TakeLeftOut(now_ns);
    }
    if (left_out > 0) {
      ConsoleWord word;
      word.severity = ConsoleWord::Severity::kWarning;
      std::snprintf(word.text.data(), word.text.size(), "%llu more texts came, and are not shown",
                    static_cast<unsigned long long>(left_out));
      words.Put(word);
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
      new_measured_cp.Put(
          {measured_pose.stamp, measured_pose.position_m, measured_pose.orientation});
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

  // Returns true if another publisher has sent messages, and takes them.
  template <typename T>
  bool HearsOthers(dds::Subscriber<T>& subscriber, const dds::Origin& ours) noexcept {
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

  // Looks for new participants. They count before their publishers are known, because the console
  // may already have received their messages.
  void LookForNewcomers() noexcept {
    const std::uint64_t num = p.num_found();
    if (num == num_found) return;
    int count = 0;
    std::uint64_t last = num_found;
    for (const dds::Newcomer& newcomer : p.FoundAfter(num_found)) {
      // An entry that was overwritten before it was read may have been any participant.
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

  // Looks for other participants that command the arm.
  void Watch() noexcept {
    LookForNewcomers();
    dds::Flag reached;
    int goals = 0;
    while (goal_reached.Take(reached)) ++goals;
    if (goals > 0) goals_reached.fetch_add(goals, std::memory_order_acq_rel);
    const int spoken = (HearsOthers(watched_hold, hold.origin()) ? 1 : 0) +
                       (HearsOthers(watched_free, {}) ? 1 : 0) +
                       (HearsOthers(watched_state_command, state_command.origin()) ? 1 : 0);
    if (spoken > 0) foreign_words.fetch_add(spoken, std::memory_order_acq_rel);
    dds::Flag flag;
    bool any = false;
    for (std::size_t i = 0; i < teleoperations.size(); ++i) {
      while (teleoperations[i]->Take(flag)) {
        teleoperated[i] = flag.value;
        if (flag.value) was_teleoperated.store(true, std::memory_order_release);
      }
      any = any || teleoperated[i];
    }
    is_teleoperated.store(any, std::memory_order_release);
    for (const auto& [subscriber, pressed] :
         {std::pair{&arm_clutch, &arm_clutched}, std::pair{&manip_clutch, &manip_clutched}}) {
      while (subscriber->Take(joy)) {
        *pressed = !joy.buttons.empty() && joy.buttons[0] != 0;
        if (*pressed) was_clutched.store(true, std::memory_order_release);
      }
    }
    is_clutched.store(arm_clutched || manip_clutched, std::memory_order_release);
    while (tool_type.Take(text)) {
      if (!tool.empty() && text.text != tool) tool_changes.fetch_add(1, std::memory_order_acq_rel);
      tool = text.text;
      // Both have the same kinematics. The latter is the only one for a da Vinci Si, whose joint
      // limits a Classic does not have.
      const bool known = tool.find("420006") != std::string::npos ||
                         (!is_si && tool.find("400006") != std::string::npos);
      wrong_tool.store(!known, std::memory_order_release);
    }
  }

  // Returns true if `topic` asks the arm to change its state.
  [[nodiscard]] bool Requests(std::string_view topic) const {
    for (const char* name : {"hold", "free", "state_command"}) {
      if (topic == Topic(name)) return true;
    }
    return false;
  }

  // Returns true if `topic` commands the arm, regardless of its type.
  [[nodiscard]] bool Commands(std::string_view topic) const {
    if (!topic.starts_with('/') || !topic.substr(1).starts_with(arm)) return false;
    topic.remove_prefix(1 + arm.size());
    for (const std::string_view part : {"/servo_", "/move_", "/interpolate_"}) {
      if (topic.find(part) != std::string_view::npos) return topic.starts_with('/');
    }
    return false;
  }

  void Count() noexcept {
    const dds::Health state = measured_js.health();
    state_publishers.store(state.publishers, std::memory_order_relaxed);
    incompatible.store(state.incompatible, std::memory_order_relaxed);
    // Excludes our own monitoring subscriber.
    command_subscribers.store(std::max(0, state_command.num_subscribers() - 1),
                              std::memory_order_relaxed);
    servo_subscribers.store(std::max(0, servo_cp.num_subscribers() - 1), std::memory_order_relaxed);
    sends_state = servo_cs && servo_cs->num_subscribers() > 0;
    // Excludes our own publisher on servo_cp.
    const int others = std::max(0, watched_servo_cp.health().publishers - 1) +
                       watched_servo_jp.health().publishers + watched_move_cp.health().publishers +
                       watched_move_jp.health().publishers;
    const int found =
        p.CountOthersPublishers([this](std::string_view topic) { return Commands(topic); });
    other_publishers.store(std::max(others, found), std::memory_order_relaxed);
  }

  dds::Participant& p;
  std::string arm;
  bool is_si;
  sem_t wake{};
  std::atomic<bool> stop{false};
  std::atomic<std::uint64_t> cycle_wanted{0};
  std::atomic<std::uint64_t> cycle_done{0};

  runtime::Queue<Outgoing, 256> outbox;
  std::atomic<bool> hold_wanted{false};
  std::atomic<bool> failed{false};
  std::atomic<std::uint64_t> sent{0};
  runtime::Latest<PsmJointSample> new_measured_js;
  runtime::Latest<PsmJointSample> new_setpoint_js;
  runtime::Latest<PsmPoseSample> new_measured_cp;
  runtime::Latest<PsmPoseSample> new_local_cp;
  runtime::Latest<PsmJawSample> new_jaw_measured;
  runtime::Latest<PsmJawSample> new_jaw_setpoint;
  runtime::Latest<PsmOperatingState> new_operating;
  runtime::Queue<ConsoleWord, kMostWords> words;
  std::atomic<std::int64_t> tick_ns{0};
  runtime::Latest<ConsoleWord> new_error;
  std::atomic<int> num_errors{0};
  std::atomic<int> state_publishers{0};
  std::atomic<int> incompatible{0};
  std::atomic<int> other_publishers{0};
  std::atomic<int> foreign_words{0};
  std::atomic<int> newcomers{0};
  std::atomic<int> goals_reached{0};
  runtime::Latest<Who> new_who;
  std::atomic<int> pose_controls{0};
  std::atomic<int> other_controls{0};
  runtime::Latest<Who> new_control;
  std::atomic<int> tool_changes{0};
  std::atomic<bool> is_teleoperated{false};
  std::atomic<bool> was_teleoperated{false};
  std::atomic<bool> is_clutched{false};
  std::atomic<bool> was_clutched{false};
  std::atomic<bool> wrong_tool{false};
  std::atomic<int> command_subscribers{0};
  std::atomic<int> servo_subscribers{0};

  // Thread only.
  WordLimit error_limit;
  WordLimit warning_limit;
  WordLimit status_limit;
  std::uint64_t num_found = 0;
  std::uint32_t lapses = 0;
  PsmStatus last_lapse = PsmStatus::kOk;
  dds::PoseStamped pose;
  dds::PoseStamped measured_pose;
  Eigen::Matrix<double, 6, 1> twist = Eigen::Matrix<double, 6, 1>::Zero();
  bool sends_state = false;
  dds::JointState joints;
  dds::JointState jaw;
  dds::OperatingState operating;
  dds::Text text;
  dds::Joy joy;
  std::string tool;
  bool arm_clutched = false;
  bool manip_clutched = false;
  std::vector<bool> teleoperated;
  std::vector<std::unique_ptr<dds::Subscriber<dds::Flag>>> teleoperations;

  dds::Publisher<dds::PoseStamped> servo_cp{p, Topic("servo_cp"), Role::kCommand};
  std::unique_ptr<dds::Publisher<dds::CartesianState>> servo_cs;
  dds::Publisher<dds::JointState> jaw_servo_jp{p, Topic("jaw/servo_jp"), Role::kCommand};
  dds::Publisher<dds::Signal> hold{p, Topic("hold"), Role::kRequest};
  dds::Publisher<dds::StringStamped> state_command{p, Topic("state_command"), Role::kRequest};
  dds::Subscriber<dds::JointState> measured_js{p, Topic("measured_js"), Role::kState};
  dds::Subscriber<dds::JointState> setpoint_js{p, Topic("setpoint_js"), Role::kState};
  dds::Subscriber<dds::PoseStamped> measured_cp{p, Topic("measured_cp"), Role::kState};
  dds::Subscriber<dds::PoseStamped> local_measured_cp{p, Topic("local/measured_cp"), Role::kState};
  dds::Subscriber<dds::JointState> jaw_measured_js{p, Topic("jaw/measured_js"), Role::kState};
  dds::Subscriber<dds::JointState> jaw_setpoint_js{p, Topic("jaw/setpoint_js"), Role::kState};
  dds::Subscriber<dds::OperatingState> operating_state{p, Topic("operating_state"), Role::kEvent};
  dds::Subscriber<dds::Text> error{p, Topic("error"), Role::kEvent};
  dds::Subscriber<dds::Text> warning{p, Topic("warning"), Role::kEvent};
  dds::Subscriber<dds::Text> status{p, Topic("status"), Role::kEvent};
  dds::Subscriber<dds::Text> tool_type{p, Topic("tool_type"), Role::kEvent};
  dds::Subscriber<dds::Joy> arm_clutch{p, Topic("arm_clutch"), Role::kEvent};      // since 2.4
  dds::Subscriber<dds::Joy> manip_clutch{p, Topic("manip_clutch"), Role::kEvent};  // before
  // A move that ends is a move of another client.
  dds::Subscriber<dds::Flag> goal_reached{p, Topic("goal_reached"), Role::kState};
  dds::Subscriber<dds::Signal> watched_hold{p, Topic("hold"), Role::kRequest};
  dds::Subscriber<dds::Signal> watched_free{p, Topic("free"), Role::kRequest};
  dds::Subscriber<dds::StringStamped> watched_state_command{p, Topic("state_command"),
                                                            Role::kRequest};
  // Only to count publishers.
  dds::Subscriber<dds::PoseStamped> watched_servo_cp{p, Topic("servo_cp"), Role::kState};
  dds::Subscriber<dds::JointState> watched_servo_jp{p, Topic("servo_jp"), Role::kState};
  dds::Subscriber<dds::PoseStamped> watched_move_cp{p, Topic("move_cp"), Role::kState};
  dds::Subscriber<dds::JointState> watched_move_jp{p, Topic("move_jp"), Role::kState};
  std::thread thread;
};

PsmDriver::PsmDriver(dds::Participant& participant, const PsmDriverOptions& options)
    : arm_(options.arm), client_(options.client) {
  DFR_THROW_UNLESS(
      !options.arm.empty() && options.arm.front() != '/',
      "arm must be the arm's name without a slash, PSM1 say, not '" << options.arm << "'");
  link_ = std::make_unique<Link>(participant, options);
}

PsmDriver::~PsmDriver() {
  if (client_.homing()) {
    Outgoing disable;
    disable.request = PsmRequest::kDisable;
    disable.stamp = dds::Stamp::Now();
    link_->outbox.Put(disable);
  }
  if (client_.phase() == PsmPhase::kArmed || client_.homing()) {
    link_->hold_wanted.store(true, std::memory_order_release);
  }
}

PsmStatus PsmDriver::Tick(std::int64_t steady_ns, std::int64_t wall_ns) noexcept {
  Link& link = *link_;
  PsmInput input;
  link.tick_ns.store(steady_ns, std::memory_order_relaxed);
  (void)link.new_error.Take(last_error_);
  // Before the number of publishers, which is always at least as recent.
  input.newcomers = link.newcomers.exchange(0, std::memory_order_acq_rel);
  const auto take = [](auto& mailbox, auto& entry) {
    if (!mailbox.Take(entry.emplace())) entry.reset();
  };
  take(link.new_operating, input.operating_state);
  take(link.new_measured_js, input.measured_js);
  take(link.new_setpoint_js, input.setpoint_js);
  take(link.new_measured_cp, input.measured_cp);
  take(link.new_local_cp, input.local_measured_cp);
  take(link.new_jaw_measured, input.jaw_measured);
  take(link.new_jaw_setpoint, input.jaw_setpoint);
  input.errors = link.num_errors.exchange(0, std::memory_order_acq_rel);
  input.state_publishers = state_publishers_ =
      link.state_publishers.load(std::memory_order_relaxed);
  input.incompatible = link.incompatible.load(std::memory_order_relaxed);
  input.other_publishers = other_publishers_ =
      link.other_publishers.load(std::memory_order_relaxed);
  servo_subscribers_ = link.servo_subscribers.load(std::memory_order_relaxed);
  input.command_subscribers = request_subscribers_ =
      link.command_subscribers.load(std::memory_order_relaxed);
  input.goals_reached = link.goals_reached.exchange(0, std::memory_order_acq_rel);
  input.foreign_words = link.foreign_words.exchange(0, std::memory_order_acq_rel);
  input.pose_controls = link.pose_controls.exchange(0, std::memory_order_acq_rel);
  input.other_controls = link.other_controls.exchange(0, std::memory_order_acq_rel);
  input.tool_changes = link.tool_changes.exchange(0, std::memory_order_acq_rel);
  input.wrong_tool = link.wrong_tool.load(std::memory_order_acquire);
  input.teleoperated = link.was_teleoperated.exchange(false, std::memory_order_acq_rel);
  input.teleoperated = link.is_teleoperated.load(std::memory_order_acquire) || input.teleoperated;
  input.clutched = link.was_clutched.exchange(false, std::memory_order_acq_rel);
  input.clutched = link.is_clutched.load(std::memory_order_acquire) || input.clutched;
  input.send_failed = link.failed.exchange(false, std::memory_order_relaxed);

  // The first participant that made the arm hold.
  const bool was_held = held_by_others();
  if (Who who; link.new_who.Take(who) && !was_held) who_ = who.text;
  if (Who who; link.new_control.Take(who)) control_ = who.text;
  const PsmOutput output = client_.Step(input, steady_ns, wall_ns);
  if (!was_held && held_by_others() && status() == PsmStatus::kForeignControl) who_ = control_;
  if (output.servo || output.servo_jaw || output.request != PsmRequest::kNone) {
    Outgoing next;
    next.servo = output.servo;
    next.position_m = output.servo_cp.translation();
    next.orientation = Eigen::Quaterniond(output.servo_cp.linear());
    next.twist = output.twist;
    next.servo_jaw = output.servo_jaw;
    next.jaw = output.jaw;
    next.request = output.request;
    next.stamp = dds::Stamp::FromNanoseconds(wall_ns);
    if (!link.outbox.Put(next)) link.failed.store(true, std::memory_order_relaxed);
  }
  if (output.hold) link.hold_wanted.store(true, std::memory_order_release);
  ::sem_post(&link.wake);
  return status();
}

PsmStatus PsmDriver::Tick() noexcept { return Tick(SteadyNs(), dds::Stamp::Now().nanoseconds()); }

bool PsmDriver::TakeWord(ConsoleWord& word) noexcept { return link_->words.Take(word); }

bool PsmDriver::held_by_others() const noexcept {
  const PsmStatus now = status();
  return client_.phase() == PsmPhase::kHolding &&
         (now == PsmStatus::kNewcomer || now == PsmStatus::kForeignWord ||
          now == PsmStatus::kOtherPublisher || now == PsmStatus::kForeignControl);
}

std::vector<dds::Newcomer> PsmDriver::Requesters() const {
  return link_->p.OthersPublishers(
      [this](std::string_view topic) { return link_->Requests(topic); });
}

std::string PsmDriver::Explain() const {
  const PsmStatus now = status();
  std::string text = arm_ + ": " + Name(now);
  if ((now == PsmStatus::kConsoleFault || now == PsmStatus::kConsoleError ||
       now == PsmStatus::kTimedOut) &&
      !last_error().empty()) {
    text += " (\"" + std::string(last_error()) + "\")";
  }
  if (held_by_others() && !who().empty()) text += " (" + std::string(who()) + ")";
  if (*Remedy(now) != '\0') text += std::string("; ") + Remedy(now);
  return text;
}

std::uint64_t PsmDriver::setpoints_sent() const noexcept {
  return link_->sent.load(std::memory_order_acquire);
}

void PsmDriver::Flush() {
  const std::uint64_t wanted = link_->cycle_wanted.fetch_add(1, std::memory_order_acq_rel) + 1;
  ::sem_post(&link_->wake);
  for (std::uint64_t done = link_->cycle_done.load(std::memory_order_acquire); done < wanted;
       done = link_->cycle_done.load(std::memory_order_acquire)) {
    link_->cycle_done.wait(done, std::memory_order_acquire);
  }
}

BringUpClock BringUpClock::Machine() {
  return {.steady_ns = &SteadyNs,
          .wall_ns = [] { return dds::Stamp::Now().nanoseconds(); },
          .wait = [] { std::this_thread::sleep_for(std::chrono::milliseconds(5)); }};
}

PsmStatus BringUp(PsmDriver& driver, double timeout_s,
                  const std::function<void(std::string_view)>& say,
                  const std::function<bool()>& may_move, const BringUpClock& clock) {
  const auto tell = [&](std::string_view text) {
    if (say) say(text);
  };
  const std::int64_t end = clock.steady_ns() + static_cast<std::int64_t>(1e9 * timeout_s);
  // Conditions shorter than discovery, or than the wait for the first sample after homing, are not
  // reported.
  constexpr std::int64_t kPatienceNs = 1'000'000'000;
  PsmStatus told = PsmStatus::kOk;
  PsmStatus seen = PsmStatus::kOk;
  std::int64_t seen_ns = 0;
  bool asked = false;
  for (; clock.steady_ns() < end; clock.wait()) {
    if (may_move && !may_move()) {
      driver.Hold();
      driver.Tick(clock.steady_ns(), clock.wall_ns());
      driver.Flush();
      return PsmStatus::kHeld;
    }
    driver.Tick(clock.steady_ns(), clock.wall_ns());
    ConsoleWord word;
    while (driver.TakeWord(word)) {
      tell(std::string("the console says (") + Name(word.severity) +
           "): " + std::string(word.view()));
    }
    if (driver.phase() == PsmPhase::kArmed) return PsmStatus::kOk;
    if (driver.phase() == PsmPhase::kRequested) continue;
    if (asked && driver.phase() == PsmPhase::kHolding) return driver.status();
    const PsmStatus reason = driver.client().hold_reason();
    if (reason == PsmStatus::kOk) {
      const PsmStatus armed = driver.Arm();
      if (armed == PsmStatus::kFrameMismatch || armed == PsmStatus::kNotFollowing) return armed;
      continue;
    }
    if ((reason == PsmStatus::kDisabled || reason == PsmStatus::kNotHomed) && !asked) {
      asked = true;
      tell(driver.arm() + ": homing");
      (void)driver.Home();
    } else if (reason == PsmStatus::kConsoleFault || reason == PsmStatus::kPaused ||
               reason == PsmStatus::kUnknownState || reason == PsmStatus::kIncompatible ||
               reason == PsmStatus::kOtherPublisher) {
      return reason;
    } else if (reason != seen) {
      seen = reason;
      seen_ns = clock.steady_ns();
    } else if (reason != told && clock.steady_ns() - seen_ns > kPatienceNs) {
      told = reason;
      tell("waiting: " + driver.Explain());
    }
  }
  return driver.client().hold_reason() == PsmStatus::kOk ? PsmStatus::kTimedOut
                                                         : driver.client().hold_reason();
}

}  // namespace dfr::hardware
