#pragma once

#include <atomic>
#include <cstdint>
#include <optional>
#include <thread>

#include "dfr/dds/emergency_stop.h"
#include "dfr/robot/devices.h"

namespace dfr::hardware {

/// Schedule for publishing the state of a loop: after each change, otherwise 50 times per second,
/// and not while the loop hangs (no beat for 0.1 s).
class RunAnnouncements {
 public:
  /// Returns true if `state` must be published now. All times are of one monotonic clock, ns.
  /// @param beat_ns  time of the loop's last beat.
  [[nodiscard]] bool Due(runtime::RunState state, std::int64_t beat_ns,
                         std::int64_t now_ns) noexcept;

 private:
  std::int64_t announced_ns_ = 0;
  runtime::RunState announced_ = runtime::RunState::kIdle;
};

/// The emergency stop of a robot::ControlLoop. A separate thread receives its messages over the
/// network, and publishes the loop's state on dds::kRunStateTopic, which `hardware stop` shows.
class EmergencyStopMonitor final : public robot::EmergencyStop {
 public:
  /// @param with_stop  false: there is no emergency stop, and the state is always clear.
  /// @param datagrams  see dds::EmergencyStopReceiver.
  EmergencyStopMonitor(dds::Participant& participant, bool with_stop, double max_silence_s,
                       bool datagrams = true);
  /// Publishes the end of the run: silence after it does not count as a failure.
  ~EmergencyStopMonitor() override;
  EmergencyStopMonitor(const EmergencyStopMonitor&) = delete;
  EmergencyStopMonitor& operator=(const EmergencyStopMonitor&) = delete;

  [[nodiscard]] robot::ThreadHealth Report() noexcept override;
  void Beat(runtime::RunState state) noexcept override;
  void Acknowledge() noexcept override { acknowledge_ = true; }

 private:
  void Run();

  std::optional<dds::EmergencyStopReceiver> receiver_;
  dds::Publisher<dds::OperatingState> announcer_;
  std::atomic<dds::EmergencyStop> stop_state_;
  std::atomic<int> num_buttons_ = 0;
  std::atomic<bool> only_datagrams_silent_ = false;
  std::atomic<bool> clocks_differ_ = false;
  std::atomic<std::int64_t> checked_ns_;
  std::atomic<runtime::RunState> state_ = runtime::RunState::kIdle;
  std::atomic<std::int64_t> beat_ns_ = 0;
  std::atomic<bool> acknowledge_ = false;
  std::atomic<bool> end_ = false;
  std::thread thread_;
};

}  // namespace dfr::hardware
