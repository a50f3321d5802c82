// Behaviour of line tracking over the network under faults: each fault many times at random moments
// of motion, in one table. With --robot this program runs as the robot's program.
#include <signal.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

#include "apps/command_line.h"
#include "bench_robot.h"
#include "commands/commands.h"
#include "dfr/core/build_info.h"
#include "dfr/core/numerics/quantile.h"
#include "dfr/core/random.h"
#include "dfr/core/text/format.h"
#include "dfr/dds/channel.h"
#include "dfr/dds/emergency_stop.h"
#include "dfr/runtime/periodic_timer.h"
#include "faults.h"
#include "lossy_wire.h"
#include "packet_storm.h"
#include "robot_site.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

constexpr double kMillisecond = 1e6;  // ns

struct Row {
  int trials = 0;
  int detected = 0;
  int restarts = 0;
  std::set<std::string> told;
  // Time until the robot's program holds, or informs the operator.
  std::vector<double> detection_ms;
  std::vector<double> rest_ms;    // time until the tip is at rest
  std::vector<double> motion_mm;  // maximum motion of the tip
};

// Returns the quantile as text, and "-" if nothing was measured.
std::string Quantile(std::vector<double> values, double q, int digits) {
  return values.empty() ? "-" : core::Format("%.*f", digits, core::Quantile(values, q));
}

void Try(Site& site, const Fault& fault, core::Random& random, Row& row) {
  constexpr double kObserved = 700.0;  // ms
  constexpr double kStill = 0.02;      // mm; smaller motions are rounding and noise
  if (fault.homing) {
    site.StartSimulator(3.0);
    site.StartRobot();
    site.AwaitHoming();
    SleepMs(random.Uniform(200.0, 900.0));
    site.Forget();
  } else {
    site.AwaitMotion();
    SleepMs(random.Uniform(200.0, 900.0));
    // Waits for the next episode if the robot is between two episodes.
    for (site.Forget(); !site.Moving(); site.Forget()) site.AwaitMotion();
  }

  Eigen::Vector3d before = site.link->Truth().tip_m;
  const std::int64_t start_ns = runtime::SteadyNow();
  fault.begin(site);
  struct Sample {
    double ms;
    Eigen::Vector3d tip_m;
  };
  std::vector<Sample> samples;
  const auto now_ms = [&] {
    return static_cast<double>(runtime::SteadyNow() - start_ns) / kMillisecond;
  };
  // Returns true if the episode ended regularly and the next one moves the arm.
  const auto next = [&site] { return site.ToldOfAnEnd() && site.Moving(); };
  while (now_ms() < kObserved) {
    site.Listen();
    if (next()) break;
    if (!fault.blind) samples.push_back({now_ms(), site.link->Truth().tip_m});
    SleepMs(1.0);
  }
  bool homed = false;
  for (dds::OperatingState state; site.operating_state.Take(state);) {
    homed = state.is_homed || state.state == "ENABLED";
  }
  fault.end(site);
  // Delayed messages may arrive now. They must not start a motion.
  for (const double end_ms = now_ms() + 300.0; now_ms() < end_ms; SleepMs(2.0)) {
    site.Listen();
    if (!next()) samples.push_back({now_ms(), site.link->Truth().tip_m});
  }

  // A broken policy is harmless until it is called.
  const double since_ms =
      site.broken_ns() ? static_cast<double>(*site.broken_ns() - start_ns) / kMillisecond : 0.0;
  std::erase_if(samples, [&](const Sample& sample) { return sample.ms < since_ms; });
  if (site.broken_ns()) before = samples.front().tip_m;

  ++row.trials;
  row.restarts += site.restarts();
  const bool told =
      (fault.to_operator ? site.operator_ns().has_value() : site.told().has_value()) &&
      !(fault.homing && homed);
  if (fault.harmless) {
    // An episode may end regularly during the fault.
    const bool ended = site.told() && !site.ToldOfAnEnd();
    row.detected += ended || site.operator_ns() ? 0 : 1;
    row.restarts = 0;
    row.told.insert(ended ? *site.told() : "nothing: the run continues");
    return;
  }
  if (told) {
    ++row.detected;
    const std::int64_t ns = fault.to_operator ? *site.operator_ns() : site.told_ns();
    // A hold reason is stamped with the start of its period, which may precede the fault.
    row.detection_ms.push_back(
        std::max(0.0, static_cast<double>(ns - start_ns) / kMillisecond - since_ms));
    row.told.insert(fault.to_operator ? "operator's screen" : *site.told());
  }
  // These faults restart or reset the arm, which changes its position. The motion is not measured.
  if (fault.name == "kill-console" || fault.name == "arm-fault" || fault.homing) return;
  double motion_mm = 0.0;
  double rest_ms = 0.0;
  const Eigen::Vector3d last = samples.back().tip_m;
  for (const Sample& sample : samples) {
    motion_mm = std::max(motion_mm, 1e3 * (sample.tip_m - before).norm());
    if (1e3 * (sample.tip_m - last).norm() > kStill) rest_ms = sample.ms - since_ms;
  }
  row.motion_mm.push_back(motion_mm);
  if (!fault.blind) row.rest_ms.push_back(rest_ms);
}

void PrintTimes(const Site& site) {
  const LoopTimes& times = site.loop_times();
  std::printf("  %d episodes; loop: %lld periods of 5 ms, %lld missed, %.1f ms off at worst\n",
              site.episodes(), times.periods, times.left_out, times.worst_ms);
}

void Measure(const std::filesystem::path& folder, int domain, double image_age_s,
             bench::LossyWire* wire, int trials, const std::vector<std::string>& only,
             std::uint64_t seed) {
  std::unique_ptr<Site> site;
  core::Random random(seed);
  constexpr double kTrialMinutes = 0.055;
  const std::size_t kinds = only.empty() ? Faults().size() : only.size();
  std::printf("%zu faults, %d times each: about %.0f minutes\n", kinds, trials,
              std::ceil(kTrialMinutes * static_cast<double>(kinds) * trials));
  std::printf("%-21s %6s %8s  %12s  %9s  %11s  %8s  %s\n", "fault", "trials", "detected",
              "after [ms]", "rest [ms]", "motion [mm]", "restarts", "message to the operator");
  std::printf("%-21s %6s %8s  %12s  %9s  %11s\n", "", "", "", "p50     max", "max", "max");
  for (const Fault& fault : Faults()) {
    if (!only.empty() && std::find(only.begin(), only.end(), fault.name) == only.end()) continue;
    bench::LossyWire* const its_wire = fault.wire ? wire : nullptr;
    if (!site || site->wire != its_wire || site->platform.has_value() != fault.platform) {
      site.reset();
      site = std::make_unique<Site>(folder, domain, its_wire, image_age_s, fault.platform);
    }
    Row row;
    for (int i = 0; i < trials; ++i) Try(*site, fault, random, row);
    std::string told;
    for (const std::string& word : row.told) told += (told.empty() ? "" : ", ") + word;
    std::printf("%-21s %6d %8d  %5s %6s  %9s  %11s  %8d  %s\n", fault.name.c_str(), row.trials,
                row.detected, Quantile(row.detection_ms, 0.5, 0).c_str(),
                Quantile(row.detection_ms, 1.0, 0).c_str(), Quantile(row.rest_ms, 1.0, 0).c_str(),
                Quantile(row.motion_mm, 1.0, 2).c_str(), row.restarts, told.c_str());
    std::fflush(stdout);
  }
}

// Injects one fault per minute, in random order, among the faults that end no program. Counts
// missed faults, false alarms, and the growth of memory.
void Soak(const std::filesystem::path& folder, int domain, double image_age_s, double minutes,
          std::uint64_t seed) {
  Site site(folder, domain, nullptr, image_age_s);
  core::Random random(core::DeriveSeed(seed, {2}));
  std::vector<Fault> faults = Faults();
  std::erase_if(faults, [](const Fault& fault) { return fault.ends; });
  std::map<std::string, int> false_alarms;
  std::map<std::string, double> memory_mb;
  double motion_mm = 0.0;
  int missed = 0;
  int restarts = 0;
  const std::int64_t start_ns = runtime::SteadyNow();
  const auto now_min = [start_ns] {
    return static_cast<double>(runtime::SteadyNow() - start_ns) / 6e10;
  };
  int minute = 0;
  for (; minute + 1 <= minutes; ++minute) {
    if (minute == 1) memory_mb = site.Memory();
    const std::size_t first = static_cast<std::size_t>(minute) % faults.size();
    std::swap(faults[first], faults[first + random.Below(faults.size() - first)]);
    const Fault& fault = faults[first];
    const double begin_min = minute + random.Uniform(0.2, 0.8);
    site.AwaitMotion();
    site.Forget();
    const auto go_on = [&](double until_min) {
      while (now_min() < until_min) {
        site.Listen();
        if (site.Stands() || site.operator_ns()) {
          if (!site.ToldOfAnEnd()) ++false_alarms[site.told().value_or("operator's screen")];
          site.AwaitMotion();
          site.Forget();
        }
        SleepMs(5.0);
      }
    };
    go_on(begin_min);
    Row row;
    Try(site, fault, random, row);
    missed += row.trials - row.detected;
    restarts += row.restarts;
    // After a regular end of an episode, the next one moves the arm.
    const double moved_mm =
        row.motion_mm.empty() || site.ToldOfAnEnd() ? 0.0 : row.motion_mm.front();
    motion_mm = std::max(motion_mm, moved_mm);
    std::printf("minute %3d  %-21s %-9s %5.2f mm  %s\n", minute, fault.name.c_str(),
                row.detected == row.trials ? "detected" : "MISSED", moved_mm,
                row.told.empty() ? "" : row.told.begin()->c_str());
    std::fflush(stdout);
    site.AwaitMotion();
    site.Forget();
    go_on(minute + 1.0);
  }
  std::printf("%d faults in %.1f minutes: %d missed, %d restarts, at most %.2f mm of motion\n",
              minute, now_min(), missed, restarts, motion_mm);
  for (const auto& [reason, count] : false_alarms) {
    std::printf("false alarm: %s, %d times\n", reason.c_str(), count);
  }
  if (false_alarms.empty()) std::printf("no false alarm\n");
  PrintTimes(site);
  for (const auto& [name, mb] : site.Memory()) {
    std::printf("%-16s %6.1f MB after a minute, %6.1f MB at the end\n", name.c_str(),
                memory_mb[name], mb);
  }
}

// Maximum time between two states of the console by their stamps, and between two messages of the
// emergency stop by their arrival.
struct Gaps {
  double state_ms = 0.0;
  double stop_ms = 0.0;
};

// Sends a packet storm for several minutes, after one quiet minute. No program may end or hang.
void Storm(const std::filesystem::path& folder, int domain, double image_age_s, double minutes,
           std::uint64_t seed) {
  constexpr double kRate = 2000.0;  // packets per second
  Site site(folder, domain, nullptr, image_age_s);
  dds::Subscriber<dds::JointState> states(site.participant, "/PSM1/measured_js",
                                          dds::Role::kRequest);
  dds::Subscriber<dds::Flag> stops(site.participant, dds::kEmergencyStopTopic, dds::Role::kRequest);
  site.AwaitMotion();
  bench::PacketStorm storm(domain, kRate, core::DeriveSeed(seed, {3}));
  std::map<std::string, int> reasons;
  const auto watch = [&](double for_minutes) {
    Gaps gaps;
    std::int64_t state_ns = 0;
    std::int64_t stop_ns = 0;
    const std::int64_t end_ns = runtime::SteadyNow() + std::llround(6e10 * for_minutes);
    std::int64_t asked_ns = 0;
    for (; runtime::SteadyNow() < end_ns; SleepMs(1.0)) {
      site.Listen();
      if (site.robot->Ended() || site.simulator->Ended() || site.stop->Ended()) {
        throw std::runtime_error(std::string(site.robot->Ended()       ? "the robot's program"
                                             : site.simulator->Ended() ? "the console"
                                                                       : "the emergency stop") +
                                 " has ended after " + std::to_string(storm.sent()) + " packets");
      }
      for (dds::JointState state; states.Take(state);) {
        if (state_ns > 0) {
          gaps.state_ms = std::max(gaps.state_ms,
                                   static_cast<double>(state.stamp.nanoseconds() - state_ns) / 1e6);
        }
        state_ns = state.stamp.nanoseconds();
      }
      for (dds::Flag flag; stops.Take(flag);) {
        const std::int64_t now_ns = runtime::SteadyNow();
        if (stop_ns > 0) {
          gaps.stop_ms = std::max(gaps.stop_ms, static_cast<double>(now_ns - stop_ns) / 1e6);
        }
        stop_ns = now_ns;
      }
      if (site.Stands() && runtime::SteadyNow() - asked_ns > 500'000'000) {
        if (site.told()) ++reasons[*site.told()];
        site.robot->Type("go\n");
        site.Forget();
        asked_ns = runtime::SteadyNow();
      }
    }
    return gaps;
  };
  const auto print = [&](const char* name, const Gaps& gaps) {
    std::printf("%s: console's states at most %.1f ms apart, emergency stop's messages %.1f ms\n",
                name, gaps.state_ms, gaps.stop_ms);
    PrintTimes(site);
    for (const auto& [reason, count] : reasons) {
      std::printf("  held: %s, %d times\n", reason.c_str(), count);
    }
    reasons.clear();
    std::fflush(stdout);
  };
  print("a minute without packets", watch(std::min(1.0, minutes)));
  const std::map<std::string, double> before_mb = site.Memory();
  storm.Blow(true);
  print("with packets", watch(minutes));
  storm.Blow(false);
  std::printf("%llu packets in %.1f minutes, made of %llu that were heard: no program has ended\n",
              static_cast<unsigned long long>(storm.sent()), minutes,
              static_cast<unsigned long long>(storm.heard()));
  for (const auto& [name, mb] : site.Memory()) {
    std::printf("%-16s %6.1f MB before, %6.1f MB after\n", name.c_str(), before_mb.at(name), mb);
  }
  site.AwaitMotion();
  std::printf("the robot continues on request\n");
}

// Creates a model and a calibration for the run.
void Prepare(const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder);
  sim::LineTrackingOptions world;
  world.observation = sim::Observation::kGroundTruth;
  calibration::CalibrationSummary summary;
  const line_task::LineCalibration known = CalibratePlant(world, 100, 3, &summary);
  known.Save(folder / "calibration.dfr");
  LineModelOptions options;
  options.gammas = {0.5};
  LineModel::Fit(Demonstrate(world, known, 50, 50, 1), options).Save(folder / "model");
}

int Main(int argc, char** argv) {
  CLI::App app("Line tracking over the network under faults, as a table.", "faults_bench");
  std::filesystem::path robot;
  std::string platform;
  bool far = false;
  int domain = 97;
  int trials = 20;
  std::uint64_t seed = 1;
  double soak_min = 0.0;
  double packets_min = 0.0;
  double image_age_s = 0.07;
  std::vector<std::string> only;
  app.add_option("--trials", trials, "trials of each fault")->capture_default_str();
  app.add_option("--only", only, "only these faults, separated by commas")->delimiter(',');
  app.add_option("--seed", seed, "random seed of the times of the faults")->capture_default_str();
  app.add_option("--domain", domain, "DDS domain that no other program uses")
      ->capture_default_str();
  app.add_option("--image-age", image_age_s,
                 "maximum age of a picture [s]; increase it on a shared machine")
      ->capture_default_str();
  app.add_option("--soak", soak_min, "instead: minutes of episodes with one fault per minute");
  app.add_option("--packets", packets_min,
                 "instead: minutes of broken packets to every port of the programs");
  app.add_option("--robot", robot)->group("");
  app.add_option("--platform", platform)->group("");
  app.add_flag("--far", far)->group("");
  if (const auto code = apps::Parse(app, argc, argv)) return *code;
  signal(SIGPIPE, SIG_IGN);
  signal(SIGXFSZ, SIG_IGN);
  if (!robot.empty()) {
    signal(SIGUSR1, [](int) { BreakPolicy(); });
    RunRobot(robot, domain, image_age_s, far ? dds::Discovery::kNetwork : dds::Discovery::kLoopback,
             platform);
    return EXIT_SUCCESS;
  }
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("faults_bench_" + std::to_string(getpid()));
  std::printf("commit %s, seed %llu\n", core::BuildCommit(), static_cast<unsigned long long>(seed));
  std::optional<bench::LossyWire> wire;
  const bool table = soak_min <= 0.0 && packets_min <= 0.0;
  try {
    if (table) wire.emplace(core::DeriveSeed(seed, {1}));
  } catch (const std::runtime_error& e) {
    std::printf("no network namespaces (%s): the console simulates losses and jitter\n", e.what());
  }
  std::fflush(stdout);
  Prepare(folder);
  if (table) Measure(folder, domain, image_age_s, wire ? &*wire : nullptr, trials, only, seed);
  if (soak_min > 0.0) Soak(folder, domain, image_age_s, soak_min, seed);
  if (packets_min > 0.0) Storm(folder, domain, image_age_s, packets_min, seed);
  std::filesystem::remove_all(folder);
  return EXIT_SUCCESS;
}

}  // namespace
}  // namespace dfr::apps::line_tracking

int main(int argc, char** argv) try {
  return dfr::apps::line_tracking::Main(argc, argv);
} catch (const std::exception& e) {
  std::cerr << "faults_bench: " << e.what() << '\n';
  return EXIT_FAILURE;
}
