#pragma once

#include <atomic>
#include <cstdint>
#include <optional>
#include <thread>

#include "dfr/dds/emergency_stop.h"
#include "dfr/runtime/fail_safe.h"

namespace dfr::apps::line_tracking {

/// Listens to the emergency stop and tells the operator's programs how the control loop fares, on
/// the topic dds::kRunStateTopic, which `hardware stop` shows, in a thread of its own:
/// what the loop calls here neither allocates, locks nor waits, and makes no call of DDS.
class Watchman {
 public:
  /// @param with_stop  whether there is an emergency stop to listen to; else it is always clear.
  Watchman(dds::Participant& participant, bool with_stop, double max_silence_s);
  ~Watchman();  ///< Says that the run ends, so that nobody takes its silence for an accident.
  Watchman(const Watchman&) = delete;
  Watchman& operator=(const Watchman&) = delete;

  /// The loop lives, and this is its state. Who is silent for a tenth of a second is not announced.
  void Beat(runtime::RunState state) noexcept;
  [[nodiscard]] dds::EmergencyStop emergency_stop() const noexcept;
  void Acknowledge() noexcept { acknowledge_ = true; }

 private:
  void Run();

  std::optional<dds::EmergencyStopReceiver> receiver_;
  dds::Publisher<dds::OperatingState> announcer_;
  std::atomic<dds::EmergencyStop> stop_state_;
  std::atomic<std::int64_t> looked_ns_;
  std::atomic<runtime::RunState> state_ = runtime::RunState::kIdle;
  std::atomic<std::int64_t> beat_ns_ = 0;
  std::atomic<bool> acknowledge_ = false;
  std::atomic<bool> end_ = false;
  std::thread thread_;
};

}  // namespace dfr::apps::line_tracking
