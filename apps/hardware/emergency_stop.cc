#include "emergency_stop.h"

#include <poll.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <iostream>
#include <string>

#include "dfr/dds/emergency_stop.h"
#include "dfr/runtime/periodic_timer.h"

namespace dfr::apps::hardware_app {
namespace {

std::atomic<bool> stopped = false;
static_assert(std::atomic<bool>::is_always_lock_free);

void Stop(int /*signal*/) { stopped = true; }

// What was typed within one beat; nothing if there was nothing. `open` becomes false at the end of
// input.
std::string Typed(bool& open) {
  pollfd input{STDIN_FILENO, POLLIN, 0};
  constexpr int kBeatMs = static_cast<int>(1e3 * dds::EmergencyStopButton::kBeat_s);
  if (poll(&input, open ? 1 : 0, kBeatMs) <= 0) return {};
  std::array<char, 256> text;
  const ssize_t size = read(STDIN_FILENO, text.data(), text.size());
  if (size > 0) return {text.data(), static_cast<std::size_t>(size)};
  open = size < 0 && errno == EINTR;
  return {};
}

// Says how the robot's program fares, by what it announces.
class RobotWatch {
 public:
  explicit RobotWatch(dds::Participant& participant)
      : subscriber_(participant, dds::kRunStateTopic, dds::Role::kState) {}

  void Show() {
    const auto now = std::chrono::steady_clock::now();
    dds::OperatingState message;
    if (subscriber_.TakeNewest(message)) {
      heard_ = now;
      if (silent_ || message.state != state_) std::cout << "robot: " << message.state << std::endl;
      silent_ = message.state == dds::kRunEnded;  // and nobody is missed
      state_ = message.state;
    } else if (!silent_ && now - heard_ > kSilence) {
      silent_ = true;
      std::cout << "robot: SILENT while " << state_
                << ". Its program hangs, was killed or cannot be heard; the arm holds" << std::endl;
    }
  }

 private:
  static constexpr std::chrono::milliseconds kSilence{150};
  dds::Subscriber<dds::OperatingState> subscriber_;
  std::string state_;
  bool silent_ = true;  // nobody is missed before it is heard for the first time
  std::chrono::steady_clock::time_point heard_;
};

}  // namespace

void RunEmergencyStop(const EmergencyStopOptions& options) {
  // Three missed beats stop a robot: better that nothing else delays them.
  constexpr int kPriority = 30;
  if (const std::string refused = runtime::AskForRealTime(kPriority); !refused.empty()) {
    std::cout << "note: " << refused << std::endl;
  }
  dds::Participant participant(options.network);
  dds::EmergencyStopButton button(participant);
  std::signal(SIGINT, Stop);
  std::signal(SIGTERM, Stop);
  std::cout << "emergency stop on " << dds::kEmergencyStopTopic << " in domain "
            << options.network.domain
            << (options.unattended
                    ? ": unattended"
                    : ": Enter presses it, r and Enter releases it, q and Enter ends (and stops)")
            << std::endl;
  bool open = !options.unattended;
  RobotWatch robot(participant);
  int listeners = -1;
  while (!stopped) {
    const std::string typed = Typed(open);
    if (typed.find('q') != std::string::npos) break;
    if (typed.find('r') != std::string::npos) {
      button.Release();
      std::cout << "released. Who was stopped stays stopped until cleared there" << std::endl;
    } else if (!typed.empty()) {
      button.Press();
      std::cout << "PRESSED" << std::endl;
    } else if (!open && !options.unattended) {
      // The terminal is gone, and with it the operator.
      std::cout << "end of input: pressed" << std::endl;
      button.Press();
      break;
    }
    button.Beat();
    robot.Show();
    if (button.num_listeners() != listeners) {
      listeners = button.num_listeners();
      std::cout << listeners << (listeners == 1 ? " robot listens" : " robots listen") << std::endl;
    }
  }
}

}  // namespace dfr::apps::hardware_app
