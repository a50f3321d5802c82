#pragma once

#include <benchmark/benchmark.h>

#include <vector>

#include "dfr/core/numerics/quantile.h"

namespace dfr::bench {

/// Reports percentiles of single calls as counters. Rearranges `times`, which has at least one.
inline void AddPercentiles(benchmark::State& state, std::vector<double>& times) {
  state.counters["p50"] = core::Quantile(times, 0.5);
  state.counters["p99"] = core::Quantile(times, 0.99);
  state.counters["p99.9"] = core::Quantile(times, 0.999);
}

}  // namespace dfr::bench
