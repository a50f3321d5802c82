#include "bench/kernel/machine.h"

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <string>

#include "bench/cpu_seconds.h"
#include "bench/kernel/contest.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "bench/kernel/machine.cc"
#include "hwy/foreach_target.h"  // recompiles this file for each instruction set
#include "hwy/highway.h"
HWY_BEFORE_NAMESPACE();
namespace dfr::bench::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using Tag = hn::CappedTag<float, 16>;

std::size_t VectorBytes() { return hn::MaxLanes(Tag()) * sizeof(float); }

// 12 chains hide the latency of an FMA on every machine with two ports and a latency up to six
// cycles.
HWY_NOINLINE float Fma(std::size_t rounds) {
  constexpr Tag d;
  constexpr int kChains = 12;
  hn::Vec<Tag> sum[kChains];
  HWY_UNROLL(12)
  for (int i = 0; i < kChains; ++i) sum[i] = hn::Set(d, static_cast<float>(i));
  const auto a = hn::Set(d, 0.5f);
  const auto b = hn::Set(d, 1.0f);
  for (std::size_t r = 0; r < rounds; ++r) {
    HWY_UNROLL(12)
    for (int i = 0; i < kChains; ++i) sum[i] = hn::MulAdd(sum[i], a, b);
  }
  HWY_UNROLL(12)
  for (int i = 1; i < kChains; ++i) sum[0] = hn::Add(sum[0], sum[i]);
  return hn::GetLane(hn::SumOfLanes(d, sum[0]));
}

HWY_NOINLINE float Load(const float* HWY_RESTRICT data, std::size_t count, std::size_t rounds) {
  constexpr Tag d;
  constexpr std::size_t kStep = hn::MaxLanes(d);
  constexpr int kChains = 8;
  hn::Vec<Tag> sum[kChains];
  HWY_UNROLL(8)
  for (int i = 0; i < kChains; ++i) sum[i] = hn::Zero(d);
  for (std::size_t r = 0; r < rounds; ++r) {
    for (std::size_t k = 0; k < count; k += kChains * kStep) {
      HWY_UNROLL(8)
      for (int i = 0; i < kChains; ++i) {
        sum[i] = hn::Add(sum[i], hn::Load(d, data + k + static_cast<std::size_t>(i) * kStep));
      }
    }
  }
  HWY_UNROLL(8)
  for (int i = 1; i < kChains; ++i) sum[0] = hn::Add(sum[0], sum[i]);
  return hn::GetLane(hn::SumOfLanes(d, sum[0]));
}

const char* Name() { return hwy::TargetName(HWY_TARGET); }

}  // namespace dfr::bench::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
#include "hwy/aligned_allocator.h"
namespace dfr::bench {

HWY_EXPORT(VectorBytes);
HWY_EXPORT(Fma);
HWY_EXPORT(Load);
HWY_EXPORT(Name);

namespace {

// Returns the minimum of many runs, which excludes interrupts.
template <typename Run>
double Least(double operations, Run&& run) {
  double least = 1e9;
  for (int i = 0; i < 15; ++i) {
    const double start = CpuSeconds();
    run();
    least = std::min(least, CpuSeconds() - start);
  }
  return least / operations * 1e9;
}

// Returns the name that Linux reports; empty if it reports none.
std::string ProcessorName() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    const std::size_t colon = line.find(": ");
    if (line.starts_with("model name") && colon != std::string::npos) return line.substr(colon + 2);
  }
  return "";
}

Machine MeasureNow() {
  Machine machine;
  machine.processor = ProcessorName();
  volatile float sink = 0.0f;
  machine.instruction_set = HWY_DYNAMIC_DISPATCH(Name)();
  machine.vector_bytes = HWY_DYNAMIC_DISPATCH(VectorBytes)();
  constexpr std::size_t kRounds = 200000;
  machine.fma_nanoseconds =
      Least(12.0 * kRounds, [&] { sink = HWY_DYNAMIC_DISPATCH(Fma)(kRounds); });
  const auto load = [&](std::size_t bytes) {
    const std::size_t count = bytes / sizeof(float);
    const auto data = hwy::AllocateAligned<float>(count);
    std::fill_n(data.get(), count, 1.0f);
    const std::size_t rounds = (std::size_t{64} << 20) / bytes;
    const double loads = static_cast<double>(rounds * bytes / machine.vector_bytes);
    return Least(loads, [&] { sink = HWY_DYNAMIC_DISPATCH(Load)(data.get(), count, rounds); });
  };
  machine.load_l1_nanoseconds = load(std::size_t{16} << 10);
  machine.load_l2_nanoseconds = load(std::size_t{256} << 10);
  return machine;
}

}  // namespace

const Machine& Measure() {
  static const Machine machine = MeasureNow();
  return machine;
}

std::string Describe(const Machine& machine) {
  char text[200];
  std::snprintf(
      text, sizeof(text),
      "%s: %s, %zu-byte vectors: multiply-add %.3f ns, load from L1 %.3f ns, from L2 %.3f ns",
      machine.processor.c_str(), machine.instruction_set.c_str(), machine.vector_bytes,
      machine.fma_nanoseconds, machine.load_l1_nanoseconds, machine.load_l2_nanoseconds);
  return text;
}

double DecisionBound(const Machine& machine, std::size_t terms, std::size_t dim,
                     std::size_t bytes_per_value, bool batch) {
  const double lanes = static_cast<double>(machine.vector_bytes / bytes_per_value);
  const double vectors = static_cast<double>(terms) / lanes;
  const double operations = static_cast<double>(dim + (bytes_per_value == 4 ? 7 : 12));
  const std::size_t bytes = terms * (dim + 1) * bytes_per_value;
  const double load = batch || bytes <= (std::size_t{32} << 10) ? machine.load_l1_nanoseconds
                                                                : machine.load_l2_nanoseconds;
  return vectors *
         std::max(operations * machine.fma_nanoseconds, static_cast<double>(dim + 1) * load);
}

}  // namespace dfr::bench
#endif  // HWY_ONCE
