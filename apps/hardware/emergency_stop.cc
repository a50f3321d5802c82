#include "emergency_stop.h"

#include <atomic>
#include <chrono>
#include <csignal>
#include <iostream>
#include <string>
#include <thread>

#include "dfr/dds/emergency_stop.h"
#include "dfr/runtime/keyboard.h"
#include "dfr/runtime/periodic_timer.h"
#include "robot_watch.h"

namespace dfr::apps::hardware_app {
namespace {

std::atomic<bool> stopped = false;
static_assert(std::atomic<bool>::is_always_lock_free);

void Stop(int /*signal*/) { stopped = true; }

}  // namespace

StopWord Meaning(std::string_view line) noexcept {
  if (line == "r") return StopWord::kRelease;
  return line == "q" ? StopWord::kEnd : StopWord::kPress;
}

void RunEmergencyStop(const EmergencyStopOptions& options) {
  // Three missed beats stop a robot, so this thread gets priority.
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
            << (options.unattended ? ": unattended"
                                   : ": Enter presses it, as does any other input. r and Enter "
                                     "release it; q and Enter press it and quit")
            << std::endl;
  runtime::Keyboard keyboard;
  // Reads the messages of all robots: the newest message alone could hide the message of another
  // robot.
  dds::Subscriber<dds::OperatingState> states(participant, dds::kRunStateTopic,
                                              dds::Role::kRequest);
  RobotWatch robots(std::cout);
  int listeners = -1;
  for (bool ends = false; !stopped && !ends;) {
    if (options.unattended) {
      std::this_thread::sleep_for(std::chrono::duration<double>(dds::EmergencyStopButton::kBeat_s));
    } else if (const auto line = keyboard.Line(dds::EmergencyStopButton::kBeat_s)) {
      const StopWord word = Meaning(*line);
      ends = word == StopWord::kEnd;
      if (word == StopWord::kRelease) {
        button.Release();
        std::cout << "released. A stopped robot stays stopped until its operator clears it"
                  << std::endl;
      } else {
        button.Press();
        std::cout << "PRESSED" << std::endl;
      }
    } else if (keyboard.ended()) {
      // The terminal, and with it the operator, is gone.
      button.Press();
      std::cout << "end of input: pressed" << std::endl;
      break;
    }
    button.Beat();
    const std::int64_t now_ns = runtime::SteadyNow();
    dds::OperatingState state;
    dds::Origin who;
    while (states.Take(state, who)) robots.Hear(who, state.state, now_ns);
    robots.Look(now_ns);
    if (button.num_listeners() != listeners) {
      listeners = button.num_listeners();
      std::cout << listeners << (listeners == 1 ? " robot listens" : " robots listen") << std::endl;
    }
  }
}

}  // namespace dfr::apps::hardware_app
