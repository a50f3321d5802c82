#include "dfr/hardware/emergency_stop_monitor.h"

#include <chrono>

#include "dfr/runtime/periodic_timer.h"

namespace dfr::hardware {
namespace {

constexpr std::int64_t kHangs = 100'000'000;          // ns
constexpr std::int64_t kAnnouncePeriod = 20'000'000;  // ns

}  // namespace

bool RunAnnouncements::Due(runtime::RunState state, std::int64_t beat_ns,
                           std::int64_t now_ns) noexcept {
  if (now_ns - beat_ns > kHangs) return false;
  if (state == announced_ && now_ns - announced_ns_ < kAnnouncePeriod) return false;
  announced_ = state;
  announced_ns_ = now_ns;
  return true;
}

EmergencyStopMonitor::EmergencyStopMonitor(dds::Participant& participant, bool with_stop,
                                           double max_silence_s, bool datagrams)
    : announcer_(participant, dds::kRunStateTopic, dds::Role::kState),
      stop_state_(with_stop ? dds::EmergencyStop::kSilent : dds::EmergencyStop::kClear),
      checked_ns_(runtime::SteadyNow()) {
  if (with_stop) {
    receiver_.emplace(participant, max_silence_s, dds::kEmergencyStopTopic, datagrams);
  }
  thread_ = std::thread([this] { Run(); });
}

EmergencyStopMonitor::~EmergencyStopMonitor() {
  end_ = true;
  thread_.join();
}

void EmergencyStopMonitor::Beat(runtime::RunState state) noexcept {
  state_ = state;
  beat_ns_ = runtime::SteadyNow();
}

robot::ThreadHealth EmergencyStopMonitor::Report() noexcept {
  const std::int64_t checked_ns = checked_ns_;
  switch (stop_state_) {
    case dds::EmergencyStop::kClear:
      return {{}, checked_ns};
    case dds::EmergencyStop::kPressed:
      return {{runtime::HoldReason::kEmergencyStop, "pressed"}, checked_ns};
    case dds::EmergencyStop::kSilent:
      break;
  }
  return {{runtime::HoldReason::kEmergencyStopSilent,
           only_datagrams_silent_ && clocks_differ_
               ? "the machines' clocks differ by over 1 s: set both by NTP or PTP"
           : only_datagrams_silent_
               ? "heard over DDS, but not by datagram: check that no firewall drops UDP broadcasts"
           : num_buttons_ > 1 ? "one of several buttons went silent"
                              : "no message from it: check that `hardware stop` is running"},
          checked_ns};
}

void EmergencyStopMonitor::Run() {
  RunAnnouncements announcements;
  for (; !end_; std::this_thread::sleep_for(std::chrono::milliseconds(2))) {
    const std::int64_t now_ns = runtime::SteadyNow();
    if (receiver_) {
      if (acknowledge_.exchange(false)) receiver_->Acknowledge();
      num_buttons_ = receiver_->num_buttons();
      const dds::EmergencyStop found = receiver_->Check(now_ns);
      only_datagrams_silent_ = receiver_->only_datagrams_silent();
      clocks_differ_ = receiver_->clocks_differ();
      stop_state_ = found;
    }
    checked_ns_ = now_ns;
    const runtime::RunState state = state_;
    if (!announcements.Due(state, beat_ns_, now_ns)) continue;
    dds::OperatingState message;
    message.stamp = dds::Stamp::Now();
    message.state = runtime::Name(state);
    announcer_.Write(message);
  }
  // Announces a regular end, so the silence after it is not reported as a failure. The sleep lets
  // DDS repeat a lost message.
  dds::OperatingState farewell;
  farewell.stamp = dds::Stamp::Now();
  farewell.state = dds::kRunEnded;
  announcer_.Write(farewell);
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
}

}  // namespace dfr::hardware
