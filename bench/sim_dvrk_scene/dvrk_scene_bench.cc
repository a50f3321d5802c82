// Rates of the simulated console: 100 states and 30 pictures per second must arrive at a client
// through DDS, with the console's millisecond loop and the drawing thread on the same machine.
// usage: dvrk_scene_bench [Google Benchmark's options]
#include <benchmark/benchmark.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <thread>
#include <vector>

#include "dfr/core/numerics/quantile.h"
#include "dfr/dds/channel.h"
#include "dfr/sim/dvrk_scene/dvrk_scene_server.h"

namespace dfr::sim {
namespace {

using Clock = std::chrono::steady_clock;

constexpr int kDomain = 112;
constexpr double kPatience_s = 20.0;

// CPU time of one millisecond of the console and its world, without a network.
void BM_SceneStep(benchmark::State& state) {
  DvrkScene scene;
  scene.Reset(1);
  kinematics::PsmJoints goal = scene.console().setpoint_joints();
  double sign = 1.0;
  for (auto _ : state) {
    goal[0] += sign * 1e-5;
    sign = -sign;
    scene.console().ServoJp(goal);
    scene.Step(1e-3);
  }
}
BENCHMARK(BM_SceneStep)->Unit(benchmark::kMicrosecond);

// CPU time of a picture, from drawing to the endoscope's noise, summed over all threads.
void BM_Picture(benchmark::State& state) {
  DvrkScene scene;
  scene.Reset(1);
  std::vector<std::uint8_t> picture(scene.plant().endoscope().image_size());
  std::uint64_t number = 0;
  for (auto _ : state) scene.plant().RenderPicture(++number, picture);
}
BENCHMARK(BM_Picture)->MeasureProcessCPUTime()->UseRealTime()->Unit(benchmark::kMillisecond);

// Measures intervals between arrivals, s.
class Arrivals {
 public:
  void Add(Clock::time_point now) {
    if (last_ != Clock::time_point{}) {
      gaps_s_.push_back(std::chrono::duration<double>(now - last_).count());
    }
    last_ = now;
  }
  [[nodiscard]] bool empty() const { return gaps_s_.empty(); }
  [[nodiscard]] double Rate() const {
    double sum_s = 0.0;
    for (const double gap_s : gaps_s_) sum_s += gap_s;
    return static_cast<double>(gaps_s_.size()) / sum_s;
  }
  [[nodiscard]] double Percentile99() { return core::Quantile(gaps_s_, 0.99); }

 private:
  Clock::time_point last_;
  std::vector<double> gaps_s_;
};

// One iteration is one second of real time.
void BM_Rates(benchmark::State& state) {
  std::atomic<bool> stopped = false;
  std::thread console([&] {
    dds::Participant control({.domain = kDomain, .name = "console"});
    dds::Participant images({.domain = kDomain, .name = "images", .shared_memory = true});
    DvrkScene scene;
    DvrkSceneServer server(control, images, scene);
    for (auto last = Clock::now(); !stopped;) {
      const auto now = Clock::now();
      server.Tick(std::min(std::chrono::duration<double>(now - last).count(), 0.1));
      last = now;
      std::this_thread::sleep_until(now + std::chrono::milliseconds(1));
    }
  });
  dds::Participant client({.domain = kDomain, .name = "client", .shared_memory = true});
  dds::Subscriber<dds::PoseStamped> poses(client, "/PSM1/measured_cp", dds::Role::kState);
  dds::Subscriber<dds::Image> images(client, "/ECM/image_raw", dds::Role::kImage);
  Arrivals states;
  Arrivals pictures;
  dds::PoseStamped pose;
  dds::Image image;
  const auto take_for = [&](double seconds) {
    const auto end = Clock::now() + std::chrono::duration<double>(seconds);
    while (Clock::now() < end) {
      if (poses.Wait(1e-3) && poses.Take(pose)) states.Add(Clock::now());
      if (images.Take(image)) pictures.Add(Clock::now());
    }
  };
  const auto patience = Clock::now() + std::chrono::duration<double>(kPatience_s);
  while ((states.empty() || pictures.empty()) && Clock::now() < patience) take_for(0.1);
  const bool found = !states.empty() && !pictures.empty();
  states = pictures = {};
  if (found) {
    for (auto _ : state) take_for(1.0);
    state.counters["state_hz"] = states.Rate();
    state.counters["state_gap_p99_ms"] = 1e3 * states.Percentile99();
    state.counters["image_hz"] = pictures.Rate();
    state.counters["image_gap_p99_ms"] = 1e3 * pictures.Percentile99();
  } else {
    state.SkipWithError("the console was not found");
  }
  stopped = true;
  console.join();
}
BENCHMARK(BM_Rates)->Iterations(3)->UseRealTime()->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace dfr::sim

BENCHMARK_MAIN();
