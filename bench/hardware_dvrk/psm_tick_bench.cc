// Cost of the arm in a control loop: one tick of the driver during a move, and the check of a new
// goal. The console is a publisher in this process that reports an arm at rest.
#include <benchmark/benchmark.h>

#include <chrono>
#include <thread>
#include <vector>

#include "dfr/core/numerics/quantile.h"
#include "dfr/dds/channel.h"
#include "dfr/hardware/psm_driver.h"

namespace {

using namespace dfr;

kinematics::PsmJoints Home() {
  kinematics::PsmJoints q = kinematics::PsmJoints::Zero();
  q[2] = 0.12;
  return q;
}

// A console that reports given measurements.
class Console {
 public:
  explicit Console(dds::Participant& participant)
      : js_(participant, "/PSM1/measured_js", dds::Role::kState),
        setpoint_js_(participant, "/PSM1/setpoint_js", dds::Role::kState),
        cp_(participant, "/PSM1/measured_cp", dds::Role::kState),
        state_(participant, "/PSM1/operating_state", dds::Role::kEvent) {
    dds::OperatingState state;
    state.state = "ENABLED";
    state.is_homed = true;
    (void)state_.Write(state);
  }

  void Publish(const kinematics::PsmJoints& at) {
    dds::JointState joints;
    joints.stamp = dds::Stamp::Now();
    joints.position.assign(at.data(), at.data() + 6);
    joints.velocity.assign(6, 0.0);
    (void)js_.Write(joints);
    (void)setpoint_js_.Write(joints);
    const Eigen::Isometry3d pose = kinematics::Psm::Forward(at);
    dds::PoseStamped wrist;
    wrist.stamp = joints.stamp;
    wrist.position_m = pose.translation();
    wrist.orientation = Eigen::Quaterniond(pose.linear());
    (void)cp_.Write(wrist);
  }

 private:
  dds::Publisher<dds::JointState> js_;
  dds::Publisher<dds::JointState> setpoint_js_;
  dds::Publisher<dds::PoseStamped> cp_;
  dds::Publisher<dds::OperatingState> state_;
};

// Ticks are 2 ms apart, as in a control loop. The benchmark times only the tick.
void BM_DriverTick(benchmark::State& state) {
  dds::Participant participant({.domain = 19});
  Console console(participant);
  hardware::PsmDriverOptions options;
  options.client.watchdog = {.max_age_s = 10.0, .max_silence_s = 10.0, .max_ahead_s = 1.0};
  options.client.max_tick_gap_s = 10.0;
  options.client.reach_timeout_s = 1e5;
  hardware::PsmDriver driver(participant, options);
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(10);
  while (driver.Arm() != hardware::PsmStatus::kOk) {
    if (std::chrono::steady_clock::now() > end)
      return state.SkipWithError("the arm is not armed after 10 s");
    console.Publish(Home());
    driver.Tick();
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  kinematics::PsmJoints goal = Home();
  int ticks = 0;
  std::vector<double> times;
  for (auto _ : state) {
    if (ticks % 100 == 0) {
      goal[0] = goal[0] > 0.0 ? 0.0 : 0.02;
      (void)driver.MoveTo(goal, 0.4);
    }
    if (ticks++ % 5 == 0) console.Publish(driver.client().setpoint());
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
    const auto start = std::chrono::steady_clock::now();
    benchmark::DoNotOptimize(driver.Tick());
    times.push_back(
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    state.SetIterationTime(times.back());
  }
  if (driver.phase() != hardware::PsmPhase::kArmed) state.SkipWithError("held during the move");
  state.counters["p50_us"] = 1e6 * core::Quantile(times, 0.5);
  state.counters["p99_us"] = 1e6 * core::Quantile(times, 0.99);
}
BENCHMARK(BM_DriverTick)->UseManualTime()->Iterations(1000)->Unit(benchmark::kMicrosecond);

// Argument: length of the tip's path in mm. Start() checks the path every half millimetre.
void BM_StartMove(benchmark::State& state) {
  hardware::PsmMotion motion({}, hardware::PsmProfile::kSmooth);
  motion.Rest(Home());
  kinematics::PsmJoints goal = Home();
  for (auto _ : state) {
    // Yaw at home moves the tip by 2 mm per degree.
    goal[0] = goal[0] > 0.0 ? -1e-9 : 0.0087 * static_cast<double>(state.range(0));
    benchmark::DoNotOptimize(motion.Start(goal, 1e3));
  }
}
BENCHMARK(BM_StartMove)->ArgName("mm")->Arg(2)->Arg(20)->Arg(100)->Unit(benchmark::kMicrosecond);

}  // namespace

BENCHMARK_MAIN();
