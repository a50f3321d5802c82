#include "faults.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdint>

#include "lossy_wire.h"
#include "simulator/simulator_link.h"

namespace dfr::apps::line_tracking {
namespace {

Fault Injected(const std::string& name, const std::string& fault, const std::string& on,
               const std::string& off) {
  return {name, [=](Site& s) { s.link->Fault(fault, on); },
          [=](Site& s) { s.link->Fault(fault, off); }, false, false};
}

// A defective cable. On a single host, the console simulates its effect on measured states.
Fault Lossy(const std::string& name, double loss) {
  const auto set = [](Site& s, double share, double jitter_s) {
    if (s.wire != nullptr) {
      s.wire->Disturb(share, jitter_s);
    } else {
      s.link->Fault("drop", std::to_string(share));
      s.link->Fault("jitter", std::to_string(jitter_s));
    }
  };
  return {
      name, [=](Site& s) { set(s, loss, 0.05); }, [=](Site& s) { set(s, 0.0, 0.0); }, false, false,
      true};
}

// Sends two messages to every port at which a process of the domain may listen: 82 bytes with one
// of Fast DDS's statistics submessages, and a fragment of a sample with parameters and without
// payload. Without dfr's filter, either message ends a process that uses Debian's Fast DDS.
void SendPackets(int domain) {
  std::vector<std::uint8_t> statistics = {'R', 'T', 'P', 'S', 2, 3, 1, 15};
  statistics.resize(20, 0xab);
  std::vector<std::uint8_t> fragment = statistics;
  statistics.insert(statistics.end(), {0x80, 1, 58});
  statistics.resize(82);
  fragment.insert(fragment.end(), {0x16, 3, 36, 0});             // kind, flags, length
  fragment.insert(fragment.end(), {0, 0, 28, 0});                // offset of the parameters
  fragment.insert(fragment.end(), {0, 0, 0, 0, 0, 0, 1, 0xc2});  // reader, writer
  fragment.insert(fragment.end(), {0, 0, 0, 0, 1, 0, 0, 0});     // sequence number
  fragment.insert(fragment.end(), {1, 0, 0, 0, 1, 0, 100, 0, 100, 0, 0, 0});  // fragment and sizes
  fragment.insert(fragment.end(), {1, 0, 0, 0});                              // end of parameters
  const int out = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  for (int offset = 0; offset < 60; ++offset) {
    to.sin_port = htons(static_cast<std::uint16_t>(7400 + 250 * domain + offset));
    for (const auto& packet : {statistics, fragment}) {
      static_cast<void>(sendto(out, packet.data(), packet.size(), MSG_NOSIGNAL,
                               reinterpret_cast<const sockaddr*>(&to), sizeof to));
    }
  }
  close(out);
}

}  // namespace

std::vector<Fault> Faults() {
  std::vector<Fault> faults;
  faults.push_back({"kill-robot", [](Site& s) { s.robot->Signal(SIGKILL); },
                    [](Site& s) { s.StartRobot(); }, false, true});
  faults.back().ends = true;
  faults.push_back({"stop-robot", [](Site& s) { s.robot->Signal(SIGSTOP); },
                    [](Site& s) { s.robot->Signal(SIGCONT); }, false, true});
  faults.push_back({"kill-console", [](Site& s) { s.simulator->Kill(); },
                    [](Site& s) {
                      s.StartSimulator();
                      s.link->Reset(1);  // Reset() homes the arm.
                    },
                    true, false});
  faults.back().ends = true;
  faults.push_back({"stop-console", [](Site& s) { s.simulator->Signal(SIGSTOP); },
                    [](Site& s) { s.simulator->Signal(SIGCONT); }, true, false});
  faults.push_back({"kill-stop-button", [](Site& s) { s.stop->Kill(); },
                    [](Site& s) { s.StartStop(); }, false, false});
  faults.back().ends = true;
  faults.push_back({"stop-stop-button", [](Site& s) { s.stop->Signal(SIGSTOP); },
                    [](Site& s) { s.stop->Signal(SIGCONT); }, false, false});
  faults.push_back({"emergency-stop", [](Site& s) { s.stop->Type("\n"); },
                    [](Site& s) { s.stop->Type("r\n"); }, false, false});
  faults.push_back(Lossy("loss-5-jitter-50ms", 0.05));
  faults.push_back(Lossy("loss-15-jitter-50ms", 0.15));
  faults.push_back(Lossy("loss-30-jitter-50ms", 0.3));
  faults.push_back(Injected("frozen-image", "camera", "frozen", "none"));
  faults.push_back(Injected("black-image", "camera", "black", "none"));
  faults.push_back(Injected("no-image", "camera", "silent", "none"));
  faults.push_back(Injected("stamp-zero", "invalid", "1", "0"));
  faults.push_back(Injected("nan-pose", "corrupt", "1", "0"));
  faults.push_back(Injected("frozen-state", "freeze", "1", "0"));
  faults.push_back(Injected("no-state", "silent", "1", "0"));
  faults.push_back(Injected("clock-ahead-1s", "clock_jump", "1", "0"));
  faults.push_back(Injected("clock-behind-1s", "clock_jump", "-1", "0"));
  faults.push_back(
      {"nan-policy", [](Site& s) { s.robot->Signal(SIGUSR1); }, [](Site&) {}, false, false});
  faults.push_back({"arm-fault", [](Site& s) { s.link->Fault("arm_fault", "overcurrent"); },
                    [](Site& s) { s.link->Reset(1); }, false, false});
  const auto second = std::make_shared<std::optional<dds::Publisher<dds::PoseStamped>>>();
  faults.push_back(
      {"second-commander",
       [second](Site& s) { second->emplace(s.participant, "/PSM1/servo_cp", dds::Role::kCommand); },
       [second](Site&) { second->reset(); }, false, false});
  faults.push_back(Injected("frozen-noisy-image", "camera", "frozen_noisy", "none"));
  faults.push_back(Injected("image-late-1s", "camera", "late", "none"));
  // Interference by another client. The site creates these publishers before the fault, as a
  // console does.
  faults.push_back({"teleoperation", [](Site& s) { s.following.Write({true}); },
                    [](Site& s) { s.following.Write({false}); }, false, false});
  faults.push_back({"clutch",
                    [](Site& s) {
                      s.clutch.Write({{}, "", {}, {1}});
                    },
                    [](Site& s) {
                      s.clutch.Write({{}, "", {}, {0}});
                    },
                    false, false});
  faults.push_back({"foreign-hold", [](Site& s) { s.hold.Write({}); }, [](Site&) {}, false, false});
  // A participant joins and sends a hold 20 times per second for .3 s. The console may discover it
  // before the robot's program does.
  const auto guest = std::make_shared<std::thread>();
  faults.push_back({"late-hold",
                    [guest](Site& s) {
                      *guest = std::thread([&s] {
                        dds::Participant joined({.domain = s.domain(),
                                                 .name = "guest",
                                                 .discovery = s.participant.options().discovery});
                        dds::Publisher<dds::Signal> hold(joined, "/PSM1/hold", dds::Role::kRequest);
                        for (int i = 0; i < 6; ++i, SleepMs(50.0)) hold.Write({});
                      });
                    },
                    [guest](Site&) { guest->join(); }, false, false});
  // The same fault, but only the console receives the message.
  faults.push_back({"unheard-hold", [](Site& s) { s.link->Fault("unheard", "hold"); }, [](Site&) {},
                    false, false});
  faults.push_back({"unheard-free", [](Site& s) { s.link->Fault("unheard", "free"); }, [](Site&) {},
                    false, false});
  const auto console = std::make_shared<std::optional<dds::Publisher<dds::JointState>>>();
  faults.push_back({"second-console",
                    [console](Site& s) {
                      console->emplace(s.participant, "/PSM1/measured_js", dds::Role::kState);
                    },
                    [console](Site&) { console->reset(); }, false, false});
  // The platform moves faster than the tip can follow.
  faults.push_back(Injected("moving-platform", "platform", "0.06", "0"));
  // Faults at the platform's port. The firmware reports nothing: its output is irrelevant, and a
  // hang is not detectable.
  faults.push_back({"platform-unplugged", [](Site& s) { s.platform->Unplug(); },
                    [](Site& s) { s.StartPlatform(); }, false, false});
  faults.back().ends = faults.back().platform = true;
  faults.push_back({"platform-garbage",
                    [](Site& s) {
                      for (int i = 0; i < 100; ++i) s.platform->Print("a\xff\x00h!d~\n");
                    },
                    [](Site&) {}, false, false, false, true});
  faults.back().ends = faults.back().platform = true;
  faults.push_back({"platform-hangs", [](Site& s) { s.platform->Hang(true); },
                    [](Site& s) { s.platform->Hang(false); }, false, false, false, true});
  faults.back().ends = faults.back().platform = true;
  faults.push_back({"packets", [](Site& s) { SendPackets(s.domain()); }, [](Site&) {}, false, false,
                    false, true});
  faults.push_back({"emergency-stop-homing", [](Site& s) { s.stop->Type("\n"); },
                    [](Site& s) { s.stop->Type("r\n"); }, false, false});
  faults.back().homing = faults.back().ends = true;
  return faults;
}

}  // namespace dfr::apps::line_tracking
