#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string_view>

#include "dfr/dds/channel.h"
#include "dfr/dds/emergency_stop.h"
#include "dfr/hardware/psm_driver.h"

namespace dfr::apps::hardware_app {

/// State of the emergency stop at one moment.
struct StopLook {
  // NOLINTNEXTLINE(google-explicit-constructor): a state alone is a StopLook
  StopLook(dds::EmergencyStop found, bool only_datagrams = false)
      : state(found), only_datagrams_silent(only_datagrams) {}

  dds::EmergencyStop state;
  bool only_datagrams_silent;  ///< True if the stop is received over DDS, but not by datagram.
};

/// Interface of a checked arm: a driver at a console, and the other participants of the network.
/// Functions behave as in hardware::PsmDriver unless stated otherwise.
class CheckedArm {
 public:
  /// A topic of the console.
  struct Topic {
    const char* name;
    dds::Health health;
    bool needed;  ///< True if the arm does not work without it.
  };
  virtual ~CheckedArm() = default;

  virtual void Tick(std::int64_t steady_ns, std::int64_t wall_ns) = 0;
  [[nodiscard]] virtual const hardware::PsmClient& client() const = 0;
  [[nodiscard]] virtual bool TakeMessage(hardware::ConsoleMessage& message) = 0;
  /// The last error that the console reported, empty if none.
  [[nodiscard]] virtual std::string_view last_error() const = 0;
  [[nodiscard]] virtual int other_publishers() const = 0;
  [[nodiscard]] virtual int state_publishers() const = 0;
  [[nodiscard]] virtual int servo_subscribers() const = 0;
  [[nodiscard]] virtual int request_subscribers() const = 0;
  [[nodiscard]] virtual std::array<Topic, 6> topics() const = 0;

  [[nodiscard]] virtual hardware::PsmStatus Arm() = 0;
  [[nodiscard]] virtual hardware::PsmStatus MoveTo(const kinematics::PsmJoints& goal,
                                                   double duration_s) = 0;
  virtual void Hold() = 0;
  virtual void Flush() = 0;
  /// Same as hardware::BringUp().
  virtual hardware::PsmStatus BringUp(double timeout_s,
                                      const std::function<void(std::string_view)>& say,
                                      const std::function<bool()>& may_move) = 0;

  /// Returns the state of the emergency stop, as dds::EmergencyStopReceiver::Check() does.
  [[nodiscard]] virtual StopLook Stop(std::int64_t steady_ns) = 0;
};

}  // namespace dfr::apps::hardware_app
