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

/// Default topic of the emergency stop (std_msgs/Bool: true while it is pressed).
inline constexpr const char* kEmergencyStopTopic = "/emergency_stop";

/// Where line tracking's program says how its control loop stands (crtk_msgs/OperatingState, the
/// states of runtime::RunState), so that whoever is at the emergency stop sees it.
inline constexpr const char* kRunStateTopic = "/line_tracking/run_state";
/// The last state of a program that ends in order. Silence without it is a reason to worry.
inline constexpr const char* kRunEnded = "ended";

/// The sending end of an emergency stop over the network: an operator's button. It says at least
/// ten times a second how it stands, because its silence stops, too. It says so twice, over DDS and
/// in datagrams of its own (UDP port 7405 + 250 domain, to all on this machine and, unless
/// discovery is loopback, on its networks), so that no failure of DDS' keeps it from being heard.
/// Never the only emergency stop: the robot's own is a switch. One object belongs to one thread at
/// a time.
class EmergencyStopButton {
 public:
  /// @throws as Publisher; std::runtime_error if the system refuses a socket.
  explicit EmergencyStopButton(Participant& participant,
                               const std::string& topic = kEmergencyStopTopic);
  ~EmergencyStopButton();
  EmergencyStopButton(const EmergencyStopButton&) = delete;
  EmergencyStopButton& operator=(const EmergencyStopButton&) = delete;

  /// Says how it stands. To be called every kBeat_s or more often. False if it could not be sent
  /// either way.
  /// @param wall_ns  now, as the datagram says.
  bool Beat(std::int64_t wall_ns = Stamp::Now().nanoseconds()) noexcept;
  /// Latches, and says so at once.
  void Press(std::int64_t wall_ns = Stamp::Now().nanoseconds()) noexcept;
  /// The operator pulls it out again: who was stopped stays stopped until told otherwise.
  void Release(std::int64_t wall_ns = Stamp::Now().nanoseconds()) noexcept;
  [[nodiscard]] bool pressed() const noexcept { return pressed_; }
  /// Robots that listen now.
  [[nodiscard]] int num_listeners() const noexcept { return publisher_.num_subscribers(); }

  static constexpr double kBeat_s = 0.02;  ///< 50 times a second.

 private:
  Publisher<Flag> publisher_;
  std::unique_ptr<internal::StopSender> datagrams_;
  bool pressed_ = false;
};

/// How an emergency stop stands, as its receiver knows.
enum class EmergencyStop {
  kClear,    ///< Heard of, and not pressed.
  kPressed,  ///< Pressed now, or since the last Acknowledge().
  kSilent,  ///< Nothing was heard for too long of one of them, or ever: it could not stop anything.
            ///< Also where there are more than eight.
};

/// Tells from what was heard of the buttons, and when, how the emergency stop stands. Every doubt
/// counts against the robot. Never allocates.
class EmergencyStopJudge {
 public:
  enum class Way { kDds, kDatagrams };

  /// @param max_silence_s  after which a button counts as absent, in [0.05, 10].
  /// @param datagrams  whether each has to be heard in datagrams, too.
  /// @throws std::invalid_argument for another max_silence_s.
  explicit EmergencyStopJudge(double max_silence_s, bool datagrams = true);

  /// A button has said how it stands.
  /// @param steady_ns  a clock that never goes back, as in Check().
  void Hear(Way way, const Origin& who, bool pressed, std::int64_t steady_ns) noexcept;
  EmergencyStop Check(std::int64_t steady_ns) noexcept;
  /// As EmergencyStopReceiver::Acknowledge().
  void Acknowledge() noexcept;
  /// Buttons that were heard over DDS and not forgotten.
  [[nodiscard]] int num_buttons() const noexcept { return over_dds_.size; }
  /// Why the last Check() found it silent: DDS is heard, the datagrams are not.
  [[nodiscard]] bool only_datagrams_silent() const noexcept { return only_datagrams_silent_; }

 private:
  // Who was heard on one of the ways, and when last.
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

/// The receiving end. It keeps track of every button that it has heard, over DDS and in datagrams:
/// where one of them is silent on either way, another that goes on does not hide that; where one is
/// pressed on either way, it is. One object belongs to one thread at a time.
class EmergencyStopReceiver {
 public:
  /// @param max_silence_s  after which it counts as absent, in [0.05, 10].
  /// @param datagrams  whether it has to be heard in datagrams, too. A button that is none of ours,
  ///   or in another subnet, is heard over DDS alone.
  /// @throws as Subscriber, std::invalid_argument for another max_silence_s; std::runtime_error if
  ///   the system refuses a socket.
  explicit EmergencyStopReceiver(Participant& participant, double max_silence_s = 0.06,
                                 const std::string& topic = kEmergencyStopTopic,
                                 bool datagrams = true);
  ~EmergencyStopReceiver();
  EmergencyStopReceiver(const EmergencyStopReceiver&) = delete;
  EmergencyStopReceiver& operator=(const EmergencyStopReceiver&) = delete;

  /// @param steady_ns  a clock that never goes back.
  /// @param wall_ns  the system's clock, by which datagrams are too old.
  EmergencyStop Check(std::int64_t steady_ns,
                      std::int64_t wall_ns = Stamp::Now().nanoseconds()) noexcept;
  /// The operator knows that it was pressed, and which buttons are gone: those that are silent now
  /// are forgotten. Without effect on those that are still pressed.
  void Acknowledge() noexcept { judge_.Acknowledge(); }
  /// Buttons that were heard over DDS and not forgotten.
  [[nodiscard]] int num_buttons() const noexcept { return judge_.num_buttons(); }
  /// Why the last Check() found it silent: DDS is heard, the datagrams are not.
  [[nodiscard]] bool only_datagrams_silent() const noexcept {
    return judge_.only_datagrams_silent();
  }

 private:
  EmergencyStopJudge judge_;
  Subscriber<Flag> subscriber_;
  std::unique_ptr<internal::StopListener> listener_;  // null without datagrams
};

}  // namespace dfr::dds
