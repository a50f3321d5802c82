// Cost of recording in a control loop.
#include <benchmark/benchmark.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <thread>
#include <vector>

#include "dfr/recording/recorder.h"

namespace dfr::recording {
namespace {

// A log file that is removed with the object.
class Log {
 public:
  Log()
      : path_(std::filesystem::temp_directory_path() /
              ("dfr-recorder-bench-" + std::to_string(::getpid()) + ".mcap")) {
    std::filesystem::remove(path_);
  }
  ~Log() {
    std::error_code ignored;
    std::filesystem::remove(path_, ignored);
  }
  Log(const Log&) = delete;
  Log& operator=(const Log&) = delete;
  [[nodiscard]] const std::filesystem::path& path() const noexcept { return path_; }

 private:
  std::filesystem::path path_;
};

// Pauses the timing after every `most` records, while the writing thread catches up. In a loop at
// 100 Hz the thread never falls behind.
void Pause(benchmark::State& state, int& since, int most) {
  if (++since < most) return;
  since = 0;
  state.PauseTiming();
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  state.ResumeTiming();
}

void BM_Record(benchmark::State& state) {
  const Log log;
  Recorder recorder(log.path(), {});
  StepRecord step;
  step.mode = "policy";
  const std::array<double, 12> numbers{};
  step.state.Assign(numbers);
  int since = 0;
  for (auto _ : state) {
    step.time_ns += 10'000'000;
    if (!recorder.Record(step)) return state.SkipWithError("a step was dropped");
    Pause(state, since, 2000);
  }
}
BENCHMARK(BM_Record);

// 640 x 480 pixels of three bytes.
void BM_Picture(benchmark::State& state) {
  const Log log;
  Recorder recorder(log.path(), {});
  std::vector<std::uint8_t> pixels(std::size_t{640} * 480 * 3);
  for (std::size_t i = 0; i < pixels.size(); ++i) pixels[i] = static_cast<std::uint8_t>(i / 7200);
  PictureView picture{.width = 640, .height = 480, .step = 1920, .data = pixels};
  int since = 0;
  for (auto _ : state) {
    ++picture.sequence;
    if (!recorder.Picture(picture)) return state.SkipWithError("a picture was dropped");
    Pause(state, since, 4);
  }
}
BENCHMARK(BM_Picture)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace dfr::recording

BENCHMARK_MAIN();
