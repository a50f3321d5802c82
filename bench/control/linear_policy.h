#pragma once

#include <span>

#include "dfr/core/policy.h"

namespace dfr::bench {

/// A linear policy of 12 state and 7 control entries, because the benchmarks measure controllers
/// and no network.
class LinearPolicy final : public core::Policy {
 public:
  int state_dim() const noexcept override { return 12; }
  int control_dim() const noexcept override { return 7; }
  void Control(int, std::span<const double> x, std::span<double> u) const noexcept override {
    for (std::size_t i = 0; i < u.size(); ++i) u[i] = 0.1 * x[i] - 0.05 * x[i + 5];
  }
};

}  // namespace dfr::bench
