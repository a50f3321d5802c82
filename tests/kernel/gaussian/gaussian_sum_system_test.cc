#include <gtest/gtest.h>

#include "tests/kernel/gaussian/gaussian_problem.h"

namespace dfr::kernel::internal {
namespace {

// Takes seconds, because the reference uses long double. This number of states is likely to include
// the rare exponents at which float rounds worst.
TEST(GaussianSumTargetsTest, GIsAccurateOnAMillionRandomAndAdversarialStates) {
  CheckDecisions(1'000'000);
}

}  // namespace
}  // namespace dfr::kernel::internal
