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
#include "simulator_link.h"
#include "tests/hardware_stewart/sprk_emulator.h"

namespace dfr::apps::line_tracking {

void SleepMs(double ms);

/// A program with pipes to its input and from its output.
class Program {
 public:
  /// @param wire  whose far host it runs on; nullptr: here.
  explicit Program(const std::vector<std::string>& command, const bench::LossyWire* wire = nullptr);
  ~Program();
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  void Signal(int number) const;
  void Kill();
  void Type(const std::string& text) const;
  /// The next whole line that it has printed, without waiting.
  std::optional<std::string> Line();
  /// Whether it has ended without being killed.
  [[nodiscard]] bool Ended() const;
  /// Memory that it has in use, MB; 0 if it has ended.
  [[nodiscard]] double resident_mb() const;

 private:
  pid_t pid_ = -1;
  int input_ = -1;
  int output_ = -1;
  std::string text_;
};

/// How the robot's control loop has kept its time so far.
struct LoopTimes {
  long long periods = 0;
  long long left_out = 0;
  double worst_ms = 0.0;
};

/// All processes of a run, and what each has said last.
class Site {
 public:
  /// @param wire_to_robot  at whose far end the robot's program and its emergency stop are;
  ///   nullptr: all of them are on one host.
  /// @param image_age_s  after which a picture is too old.
  /// @param with_platform  the robot's program has one, whose port is an emulator's.
  Site(std::filesystem::path folder, int domain, bench::LossyWire* wire_to_robot,
       double image_age_s, bool with_platform = false);

  /// @param homing_s  what homing the arm takes.
  void StartSimulator(double homing_s = 0.1);
  void StartStop();
  void StartRobot();
  /// A new one, and the robot's program with it.
  void StartPlatform();

  /// Reads what the robot's program and the stop have printed.
  void Listen();
  [[nodiscard]] int domain() const { return domain_; }
  [[nodiscard]] bool Moving() const { return state_ == "running" || state_ == "recovering"; }
  [[nodiscard]] bool Stands() const { return state_ == "holding" || state_ == "faulted"; }

  /// Until the robot moves. @throws std::runtime_error if it does not within a minute.
  void AwaitMotion();
  /// Until the arm homes. @throws as AwaitMotion().
  void AwaitHoming();
  void Forget();

  /// The first reason to hold since Forget(), and when it was found.
  [[nodiscard]] const std::optional<std::string>& told() const { return told_; }
  [[nodiscard]] std::int64_t told_ns() const { return told_ns_; }
  /// Whether that is how episodes end.
  [[nodiscard]] bool ToldOfAnEnd() const {
    return told_ && (*told_ == "controller-halted" || *told_ == "not-seen");
  }
  [[nodiscard]] const std::optional<std::int64_t>& operator_ns() const { return operator_ns_; }
  /// When the policy first said NaN.
  [[nodiscard]] const std::optional<std::int64_t>& broken_ns() const { return broken_ns_; }
  [[nodiscard]] int restarts() const { return restarts_; }
  /// As of the last episode's end.
  [[nodiscard]] const LoopTimes& loop_times() const { return loop_times_; }
  [[nodiscard]] int episodes() const { return episodes_; }
  /// What each program has in use, MB, by its name.
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
