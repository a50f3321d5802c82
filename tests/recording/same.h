#pragma once

#include <gtest/gtest.h>

#include <cstring>
#include <span>

#include "dfr/recording/records.h"

namespace dfr::test {

/// Compares bits: NaN equals itself and -0 does not equal 0.
inline bool Same(std::span<const double> a, std::span<const double> b) {
  return a.size() == b.size() &&
         (a.empty() || std::memcmp(a.data(), b.data(), a.size_bytes()) == 0);
}
inline bool Same(double a, double b) { return Same(std::span(&a, 1), std::span(&b, 1)); }

inline testing::AssertionResult Same(const recording::StepRecord& a,
                                     const recording::StepRecord& b) {
#define DFR_CHECK(condition) \
  if (!(condition)) return testing::AssertionFailure() << "false: " #condition
  DFR_CHECK(a.time_ns == b.time_ns);
  DFR_CHECK(a.episode == b.episode);
  DFR_CHECK(a.seed == b.seed);
  DFR_CHECK(a.t == b.t);
  DFR_CHECK(a.iteration == b.iteration);
  DFR_CHECK(a.mode == b.mode);
  DFR_CHECK(a.cause == b.cause);
  DFR_CHECK(a.machine == b.machine);
  DFR_CHECK(a.applied == b.applied);
  DFR_CHECK(a.filtered == b.filtered);
  DFR_CHECK(a.certified == b.certified);
  DFR_CHECK(Same(a.g, b.g));
  DFR_CHECK(Same(a.log_g, b.log_g));
  DFR_CHECK(Same(a.threshold, b.threshold));
  DFR_CHECK(Same(a.decision_s, b.decision_s));
  DFR_CHECK(Same(a.state.view(), b.state.view()));
  DFR_CHECK(Same(a.command.view(), b.command.view()));
  DFR_CHECK(a.image_sequence == b.image_sequence);
  DFR_CHECK(a.image_time_ns == b.image_time_ns);
#undef DFR_CHECK
  return testing::AssertionSuccess();
}

inline testing::AssertionResult Same(const recording::ArmRecord& a, const recording::ArmRecord& b) {
  const bool same =
      a.time_ns == b.time_ns && a.measured_ns == b.measured_ns &&
      Same(a.position.view(), b.position.view()) && Same(a.velocity.view(), b.velocity.view()) &&
      Same(a.setpoint.view(), b.setpoint.view()) &&
      Same(a.console_setpoint.view(), b.console_setpoint.view()) &&
      a.operating_state == b.operating_state && a.homed == b.homed && a.busy == b.busy &&
      a.machine == b.machine && a.fault == b.fault && a.stop == b.stop;
  return same ? testing::AssertionSuccess()
              : testing::AssertionFailure()
                    << "states of the arm at " << a.time_ns << " and " << b.time_ns << " differ";
}

inline testing::AssertionResult Same(const recording::TransitionRecord& a,
                                     const recording::TransitionRecord& b) {
  if (a.time_ns == b.time_ns && a.from == b.from && a.to == b.to && a.cause == b.cause) {
    return testing::AssertionSuccess();
  }
  return testing::AssertionFailure() << a.from.view() << " -> " << a.to.view() << " is not "
                                     << b.from.view() << " -> " << b.to.view();
}

}  // namespace dfr::test
