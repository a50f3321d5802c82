#pragma once

#include <sys/types.h>

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "dfr/dds/channel.h"
#include "lossy_wire.h"
#include "simulator/simulator_link.h"
#include "tests/hardware_stewart/sprk_emulator.h"

namespace dfr::apps::line_tracking {

void SleepMs(double ms);

/// A program with pipes to its input and from its output.
class Program {
 public:
  /// @param wire  runs it on the wire's far host; nullptr: on this host.
  explicit Program(const std::vector<std::string>& command, const bench::LossyWire* wire = nullptr);
  ~Program();
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  void Signal(int number) const;
  void Kill();
  void Type(const std::string& text) const;
  /// Returns the next complete line of output without waiting.
  std::optional<std::string> Line();
  /// Returns true if the program has ended without being killed.
  [[nodiscard]] bool Ended() const;
  /// Returns the program's resident memory, MB; 0 if it has ended.
  [[nodiscard]] double resident_mb() const;

 private:
  pid_t pid_ = -1;
  int input_ = -1;
  int output_ = -1;
  std::string text_;
};

/// Timing statistics of the robot's control loop.
struct LoopTimes {
  long long periods = 0;
  long long left_out = 0;
  double worst_ms = 0.0;
};

/// All processes of a run, and the last output of each.
class Site {
 public:
  /// @param wire_to_robot  wire with the robot's program and its emergency stop at the far end;
  ///   nullptr: one host for all.
  /// @param image_age_s  maximum age of a picture.
  /// @param with_platform  gives the robot's program a platform at an emulator's port.
  Site(std::filesystem::path folder, int domain, bench::LossyWire* wire_to_robot,
       double image_age_s, bool with_platform = false);

  /// @param homing_s  duration of homing the arm.
  void StartSimulator(double homing_s = 0.1);
  void StartStop();
  void StartRobot();
  /// Starts a new platform and restarts the robot's program.
  void StartPlatform();

  /// Reads the output of the robot's program and the stop.
  void Listen();
  [[nodiscard]] int domain() const { return domain_; }
  [[nodiscard]] bool Moving() const { return state_ == "running" || state_ == "recovering"; }
  [[nodiscard]] bool Stands() const { return state_ == "holding" || state_ == "faulted"; }

  /// Waits until the robot moves. @throws std::runtime_error if it does not move within a minute.
  void AwaitMotion();
  /// Waits until the arm homes. @throws as AwaitMotion().
  void AwaitHoming();
  void Forget();

  /// Returns the first reason to hold since Forget(), and its time.
  [[nodiscard]] const std::optional<std::string>& told() const { return told_; }
  [[nodiscard]] std::int64_t told_ns() const { return told_ns_; }
  /// Returns true if told() is a regular end of an episode.
  [[nodiscard]] bool ToldOfAnEnd() const {
    return told_ && (*told_ == "controller-halted" || *told_ == "not-seen");
  }
  [[nodiscard]] const std::optional<std::int64_t>& operator_ns() const { return operator_ns_; }
  /// Returns the time of the policy's first NaN.
  [[nodiscard]] const std::optional<std::int64_t>& broken_ns() const { return broken_ns_; }
  [[nodiscard]] int restarts() const { return restarts_; }
  /// Timing as of the end of the last episode.
  [[nodiscard]] const LoopTimes& loop_times() const { return loop_times_; }
  [[nodiscard]] int episodes() const { return episodes_; }
  /// Returns the memory of each program, MB, by name.
  [[nodiscard]] std::map<std::string, double> Memory() const;

 private:
  [[nodiscard]] std::string discovery() const { return wire != nullptr ? "network" : "loopback"; }

  std::filesystem::path folder_;
  int domain_;
  double image_age_s_;
  std::string state_;
  std::optional<std::string> told_;
  std::int64_t told_ns_ = 0;
  std::optional<std::int64_t> operator_ns_;
  std::optional<std::int64_t> broken_ns_;
  int restarts_ = 0;
  LoopTimes loop_times_;
  int episodes_ = 0;

 public:
  bench::LossyWire* wire;
  dds::Participant participant;
  dds::Publisher<dds::Flag> following{participant, "/MTMR_PSM1/following", dds::Role::kEvent};
  dds::Publisher<dds::Joy> clutch{participant, "/PSM1/arm_clutch", dds::Role::kEvent};
  dds::Publisher<dds::Signal> hold{participant, "/PSM1/hold", dds::Role::kRequest};
  dds::Subscriber<dds::OperatingState> operating_state{participant, "/PSM1/operating_state",
                                                       dds::Role::kEvent};
  std::optional<test::SprkEmulator> platform;
  std::optional<Program> simulator;
  std::optional<Program> stop;
  std::optional<Program> robot;
  std::optional<SimulatorLink> link;
};

}  // namespace dfr::apps::line_tracking
