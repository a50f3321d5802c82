#pragma once

#include <semaphore.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <initializer_list>
#include <memory>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "dfr/dds/channel.h"
#include "dfr/hardware/psm_driver.h"
#include "dfr/hardware/word_limit.h"
#include "dfr/runtime/latest.h"
#include "dfr/runtime/queue.h"
#include "until_sent.h"

namespace dfr::hardware {
namespace internal {

// Description of the sender of a foreign message, truncated if necessary.
struct Who {
  std::array<char, 160> text{};
};

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

}  // namespace internal

// The DDS side: a thread that sends the output of Tick() and receives its input through mailboxes.
// Only that thread uses publishers and subscribers.
struct PsmDriver::Link {  // NOLINT(clang-analyzer-optin.performance.Padding): by meaning
  Link(dds::Participant& participant, const PsmDriverOptions& options);
  ~Link();
  Link(const Link&) = delete;
  Link& operator=(const Link&) = delete;

  [[nodiscard]] std::string Topic(const char* name) const { return "/" + arm + "/" + name; }

  void Run() noexcept;
  // Returns true if a request was sent.
  bool Send() noexcept;
  // Waits until the console has received the requests, at most until `end_ns` of the monotonic
  // clock.
  void WaitForRequests(std::int64_t end_ns) noexcept;
  bool WriteRequest(PsmRequest request, const dds::Stamp& stamp) noexcept;
  bool WriteServo() noexcept;
  void NoteControl(const ConsoleMessage& message) noexcept;
  void Receive() noexcept;

  // Returns true if another publisher has sent messages, and takes them.
  template <typename T>
  bool HearsOthers(dds::Subscriber<T>& subscriber, const dds::Origin& ours) noexcept;

  // Detects new participants. A participant counts as present before its publishers are known,
  // because the console may already have received its messages.
  void LookForNewcomers() noexcept;

  // Detects other participants that command the arm.
  void ReadMonitors() noexcept;

  // Subscribes to topics but does not read them: a discovery server hides the publishers of topics
  // without subscription. Does not subscribe to servo_cs, because drivers would mistake a
  // subscriber for a console. The set-points reveal the effect of servo_cs.
  template <typename T>
  void Subscribe(std::initializer_list<const char*> topics);

  // Returns "/servo_cp" for "/PSM1/servo_cp"; empty if the topic does not belong to the arm.
  [[nodiscard]] std::string_view OfTheArm(std::string_view topic) const;

  // Returns true if messages on `topic` make the arm hold or be free, or change its state or
  // settings.
  [[nodiscard]] bool Requests(std::string_view topic) const;

  // Returns true if `topic` commands the arm, regardless of its type.
  [[nodiscard]] bool Commands(std::string_view topic) const;

  void Count() noexcept;

  dds::Participant& p;
  std::string arm;
  bool is_si;
  sem_t wake{};
  std::atomic<bool> stop{false};
  std::atomic<std::uint64_t> cycle_wanted{0};
  std::atomic<std::uint64_t> cycle_done{0};

  runtime::Queue<internal::Outgoing, 256> outbox;
  internal::UntilSent hold_wanted;
  // A `disable` that could not be sent or queued at first.
  internal::UntilSent disable_wanted;
  std::atomic<bool> failed{false};
  std::atomic<std::uint64_t> sent{0};
  runtime::Latest<PsmJointSample> new_measured_js;
  runtime::Latest<PsmJointSample> new_setpoint_js;
  runtime::Latest<PsmPoseSample> new_measured_cp;
  runtime::Latest<PsmPoseSample> new_local_cp;
  runtime::Latest<PsmJawSample> new_jaw_measured;
  runtime::Latest<PsmJawSample> new_jaw_setpoint;
  runtime::Latest<PsmOperatingState> new_operating;
  runtime::Queue<ConsoleMessage, 64> messages;
  std::atomic<std::int64_t> tick_ns{0};
  runtime::Latest<ConsoleMessage> new_error;
  std::atomic<int> num_errors{0};
  std::atomic<int> state_publishers{0};
  std::atomic<int> incompatible{0};
  std::atomic<int> other_publishers{0};
  std::atomic<int> foreign_messages{0};
  std::atomic<int> newcomers{0};
  std::atomic<int> goals_reached{0};
  runtime::Latest<internal::Who> new_who;
  std::atomic<int> pose_controls{0};
  std::atomic<int> other_controls{0};
  runtime::Latest<internal::Who> new_control;
  std::atomic<int> tool_changes{0};
  std::atomic<bool> is_teleoperated{false};
  std::atomic<bool> was_teleoperated{false};
  std::atomic<bool> is_clutched{false};
  std::atomic<bool> was_clutched{false};
  std::atomic<PsmInstrument> instrument{PsmInstrument::kNotNamed};
  std::atomic<int> command_subscribers{0};
  std::atomic<int> hold_subscribers{0};
  std::atomic<int> servo_subscribers{0};

  // Used only by the thread that runs Run().
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

  dds::Publisher<dds::PoseStamped> servo_cp{p, Topic("servo_cp"), dds::Role::kCommand};
  std::unique_ptr<dds::Publisher<dds::CartesianState>> servo_cs;
  dds::Publisher<dds::JointState> jaw_servo_jp{p, Topic("jaw/servo_jp"), dds::Role::kCommand};
  dds::Publisher<dds::Signal> hold{p, Topic("hold"), dds::Role::kRequest};
  dds::Publisher<dds::StringStamped> state_command{p, Topic("state_command"), dds::Role::kRequest};
  dds::Subscriber<dds::JointState> measured_js{p, Topic("measured_js"), dds::Role::kState};
  dds::Subscriber<dds::JointState> setpoint_js{p, Topic("setpoint_js"), dds::Role::kState};
  dds::Subscriber<dds::PoseStamped> measured_cp{p, Topic("measured_cp"), dds::Role::kState};
  dds::Subscriber<dds::PoseStamped> local_measured_cp{p, Topic("local/measured_cp"),
                                                      dds::Role::kState};
  dds::Subscriber<dds::JointState> jaw_measured_js{p, Topic("jaw/measured_js"), dds::Role::kState};
  dds::Subscriber<dds::JointState> jaw_setpoint_js{p, Topic("jaw/setpoint_js"), dds::Role::kState};
  dds::Subscriber<dds::OperatingState> operating_state{p, Topic("operating_state"),
                                                       dds::Role::kEvent};
  dds::Subscriber<dds::Text> error{p, Topic("error"), dds::Role::kEvent};
  dds::Subscriber<dds::Text> warning{p, Topic("warning"), dds::Role::kEvent};
  dds::Subscriber<dds::Text> status{p, Topic("status"), dds::Role::kEvent};
  dds::Subscriber<dds::Text> tool_type{p, Topic("tool_type"), dds::Role::kEvent};
  // Consoles publish arm_clutch since version 2.4, manip_clutch before.
  dds::Subscriber<dds::Joy> arm_clutch{p, Topic("arm_clutch"), dds::Role::kEvent};
  dds::Subscriber<dds::Joy> manip_clutch{p, Topic("manip_clutch"), dds::Role::kEvent};
  // This client starts no moves inside the console: a reached goal belongs to another client.
  dds::Subscriber<dds::Flag> goal_reached{p, Topic("goal_reached"), dds::Role::kState};
  dds::Subscriber<dds::Signal> watched_hold{p, Topic("hold"), dds::Role::kRequest};
  dds::Subscriber<dds::Signal> watched_free{p, Topic("free"), dds::Role::kRequest};
  dds::Subscriber<dds::StringStamped> watched_state_command{p, Topic("state_command"),
                                                            dds::Role::kRequest};
  // The topic's publishers include this participant's own.
  dds::Subscriber<dds::PoseStamped> watched_servo_cp{p, Topic("servo_cp"), dds::Role::kState};
  std::vector<std::shared_ptr<void>> watched;  // see Subscribe()
  std::thread thread;
};

}  // namespace dfr::hardware
