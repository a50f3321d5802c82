#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>

#include "dfr/dds/channel.h"

namespace dfr::dds {

namespace internal {
class StopListener;
class StopSender;
}  // namespace internal

/// Default topic of the emergency stop (std_msgs/Bool: true while the button is pressed).
inline constexpr const char* kEmergencyStopTopic = "/emergency_stop";

/// Topic on which the line tracking program reports the state of its control loop
/// (crtk_msgs/OperatingState, the states of runtime::RunState), for display at the emergency stop.
inline constexpr const char* kRunStateTopic = "/line_tracking/run_state";
/// Last state reported by a program that ends normally. Silence without this report is a failure.
inline constexpr const char* kRunEnded = "ended";

/// Sender of an emergency stop over the network: an operator's button. Sends over two independent
/// paths, DDS and UDP datagrams, because a failure of DDS must not block the stop. The datagrams go
/// to port 7405 + 250 * domain of this machine and, unless discovery is kLoopback, are broadcast on
/// its networks. Never use this as the only emergency stop: the robot needs a hardware switch. One
/// object belongs to one thread at a time.
class EmergencyStopButton {
 public:
  /// @throws as Publisher; std::runtime_error if the system refuses a socket.
  explicit EmergencyStopButton(Participant& participant,
                               const std::string& topic = kEmergencyStopTopic);
  ~EmergencyStopButton();
  EmergencyStopButton(const EmergencyStopButton&) = delete;
  EmergencyStopButton& operator=(const EmergencyStopButton&) = delete;

  /// Sends the state. Call it at least every kBeat_s, because silence also stops the robot. Returns
  /// false if neither path could send the state.
  /// @param wall_ns  current system time, for the datagram's stamp.
  bool Beat(std::int64_t wall_ns = Stamp::Now().nanoseconds()) noexcept;
  /// Latches the stop and sends it at once.
  void Press(std::int64_t wall_ns = Stamp::Now().nanoseconds()) noexcept;
  /// Releases the button. Stopped robots stay stopped until an operator restarts them.
  void Release(std::int64_t wall_ns = Stamp::Now().nanoseconds()) noexcept;
  [[nodiscard]] bool pressed() const noexcept { return pressed_; }
  /// Returns the number of listening robots.
  [[nodiscard]] int num_listeners() const noexcept { return publisher_.num_subscribers(); }

  static constexpr double kBeat_s = 0.02;  ///< 50 times per second.

 private:
  Publisher<Flag> publisher_;
  std::unique_ptr<internal::StopSender> datagrams_;
  bool pressed_ = false;
};

/// State of an emergency stop, as known to its receiver.
enum class EmergencyStop {
  kClear,    ///< Messages arrive, and no button is pressed.
  kPressed,  ///< A button is pressed, or was pressed after the last Acknowledge().
  kSilent,   ///< A known button is silent on a path, or no button is known: an operator could not
             ///< stop the robot. Also reported for more than eight buttons.
};

/// Determines the state of the emergency stop from the buttons' messages and their times. Returns
/// kClear only if no button is pressed or silent. Never allocates.
class EmergencyStopJudge {
 public:
  enum class Way { kDds, kDatagrams };

  /// @param max_silence_s  maximum silence of a button, in [0.05, 10].
  /// @param datagrams  if true, silence of the datagrams is also reported.
  /// @throws std::invalid_argument if max_silence_s is out of range.
  explicit EmergencyStopJudge(double max_silence_s, bool datagrams = true);

  /// Processes one message from a button.
  /// @param steady_ns  time of the same monotonic clock as in Check().
  void Hear(Way way, const Origin& who, bool pressed, std::int64_t steady_ns) noexcept;
  EmergencyStop Check(std::int64_t steady_ns) noexcept;
  /// Same as EmergencyStopReceiver::Acknowledge().
  void Acknowledge() noexcept;
  /// Returns the number of buttons heard over DDS and not forgotten.
  [[nodiscard]] int num_buttons() const noexcept { return over_dds_.size; }
  /// True if the last Check() found silence on the datagram path only.
  [[nodiscard]] bool only_datagrams_silent() const noexcept { return only_datagrams_silent_; }

 private:
  // Buttons heard on one path, with the time of the last message.
  struct Buttons {
    struct Button {
      Origin who{};
      std::int64_t heard_ns = 0;
    };
    std::array<Button, 8> buttons{};
    int size = 0;
    bool too_many = false;

    void Hear(const Origin& who, std::int64_t now_ns) noexcept;
    void Forget(std::int64_t before_ns) noexcept;
    [[nodiscard]] bool Silent(std::int64_t before_ns) const noexcept;
  };

  std::int64_t max_silence_ns_;
  bool datagrams_;
  std::int64_t now_ns_ = 0;
  Buttons over_dds_;
  Buttons in_datagrams_;
  bool latched_ = false;
  bool only_datagrams_silent_ = false;
};

/// Receiver of the emergency stop. Tracks every button separately on each path: one button cannot
/// hide the silence of another. A button counts as pressed if either path reports it. One object
/// belongs to one thread at a time.
class EmergencyStopReceiver {
 public:
  /// @param max_silence_s  maximum silence of a button, in [0.05, 10].
  /// @param datagrams  if true, datagrams are required. Set false for third-party buttons and for
  ///   buttons in another subnet, which are heard over DDS only.
  /// @throws as Subscriber; std::invalid_argument if max_silence_s is out of range;
  ///   std::runtime_error if the system refuses a socket.
  explicit EmergencyStopReceiver(Participant& participant, double max_silence_s = 0.06,
                                 const std::string& topic = kEmergencyStopTopic,
                                 bool datagrams = true);
  ~EmergencyStopReceiver();
  EmergencyStopReceiver(const EmergencyStopReceiver&) = delete;
  EmergencyStopReceiver& operator=(const EmergencyStopReceiver&) = delete;

  /// @param steady_ns  time of a monotonic clock.
  /// @param wall_ns  the system time, used to reject old datagrams.
  EmergencyStop Check(std::int64_t steady_ns,
                      std::int64_t wall_ns = Stamp::Now().nanoseconds()) noexcept;
  /// Confirms that the operator has noticed the stop and any missing buttons. Forgets buttons that
  /// are silent now. No effect on buttons that are still pressed.
  void Acknowledge() noexcept { judge_.Acknowledge(); }
  /// Returns the number of buttons heard over DDS and not forgotten.
  [[nodiscard]] int num_buttons() const noexcept { return judge_.num_buttons(); }
  /// True if the last Check() found silence on the datagram path only.
  [[nodiscard]] bool only_datagrams_silent() const noexcept {
    return judge_.only_datagrams_silent();
  }
  /// True if the last datagram was refused because its stamp differs from this machine's clock by
  /// more than a second.
  [[nodiscard]] bool clocks_differ() const noexcept;

 private:
  EmergencyStopJudge judge_;
  Subscriber<Flag> subscriber_;
  std::unique_ptr<internal::StopListener> listener_;  // nullptr without datagrams
};

}  // namespace dfr::dds
