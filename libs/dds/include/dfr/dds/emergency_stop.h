#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "dfr/dds/channel.h"

namespace dfr::dds {

/// Default topic of the emergency stop (std_msgs/Bool: true while it is pressed).
inline constexpr const char* kEmergencyStopTopic = "/emergency_stop";

/// Where line tracking's program says how its control loop stands (crtk_msgs/OperatingState, the
/// states of runtime::RunState), so that whoever is at the emergency stop sees it.
inline constexpr const char* kRunStateTopic = "/line_tracking/run_state";
/// The last state of a program that ends in order. Silence without it is a reason to worry.
inline constexpr const char* kRunEnded = "ended";

/// The sending end of an emergency stop over the network: an operator's button. It says at least
/// ten times a second how it stands, because its silence stops, too. Never the only emergency stop:
/// the robot's own is a switch. One object belongs to one thread at a time.
class EmergencyStopButton {
 public:
  /// @throws as Publisher.
  explicit EmergencyStopButton(Participant& participant,
                               const std::string& topic = kEmergencyStopTopic);

  /// Says how it stands. To be called every kBeat_s or more often. False if it could not be sent.
  bool Beat() noexcept;
  /// Latches, and says so at once.
  void Press() noexcept;
  /// The operator pulls it out again: who was stopped stays stopped until told otherwise.
  void Release() noexcept;
  [[nodiscard]] bool pressed() const noexcept { return pressed_; }
  /// Robots that listen now.
  [[nodiscard]] int num_listeners() const noexcept { return publisher_.num_subscribers(); }

  static constexpr double kBeat_s = 0.02;  ///< 50 times a second.

 private:
  Publisher<Flag> publisher_;
  bool pressed_ = false;
};

/// How an emergency stop stands, as its receiver knows.
enum class EmergencyStop {
  kClear,    ///< Heard of, and not pressed.
  kPressed,  ///< Pressed now, or since the last Acknowledge().
  kSilent,  ///< Nothing was heard for too long of one of them, or ever: it could not stop anything.
            ///< Also where there are more than eight.
};

/// The receiving end. It keeps track of every button that it has heard: where one of them is
/// silent, another that goes on does not hide that. One object belongs to one thread at a time.
class EmergencyStopReceiver {
 public:
  /// @param max_silence_s  after which it counts as absent, in [0.05, 10].
  /// @throws as Subscriber, and std::invalid_argument for another max_silence_s.
  explicit EmergencyStopReceiver(Participant& participant, double max_silence_s = 0.06,
                                 const std::string& topic = kEmergencyStopTopic);

  /// @param steady_ns  a clock that never goes back.
  EmergencyStop Check(std::int64_t steady_ns) noexcept;
  /// The operator knows that it was pressed, and which buttons are gone: those that are silent now
  /// are forgotten. Without effect on those that are still pressed.
  void Acknowledge() noexcept;
  /// Buttons that were heard and not forgotten.
  [[nodiscard]] int num_buttons() const noexcept { return num_buttons_; }

 private:
  struct Button {
    Origin who{};
    std::int64_t heard_ns = 0;
  };
  void Hear(const Origin& who) noexcept;

  Subscriber<Flag> subscriber_;
  std::int64_t max_silence_ns_;
  std::int64_t now_ns_ = 0;
  std::array<Button, 8> buttons_{};
  int num_buttons_ = 0;
  bool too_many_ = false;
  bool latched_ = false;
};

}  // namespace dfr::dds
