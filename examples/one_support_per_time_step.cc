// Shows the need for one support estimate per time step (Sec. IV-A). A supervisor is in B_0 once,
// at the start, and in B_1 from then on. The smallest set that holds most of the pooled states
// excludes B_0, although every demonstration was there. Exits 1 if the result differs.
#include <cstdio>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/kernel/time_varying_support.h"

int main() {
  dfr::core::Random random(/*seed=*/1);
  std::vector<dfr::core::Matrix> demonstrations(60, dfr::core::Matrix(50, 1));
  for (dfr::core::Matrix& states : demonstrations) {
    states(0, 0) = -3.0 + 0.05 * random.Normal();                              // B_0
    for (int t = 1; t < 50; ++t) states(t, 0) = 3.0 + 0.05 * random.Normal();  // B_1
  }

  dfr::kernel::TimeVaryingSupportOptions options{.svm = {.nu = 0.1, .gamma = 1.0}};
  const auto varying = dfr::kernel::TimeVaryingSupport::Fit(demonstrations, options);
  options.pooled = true;
  const auto pooled = dfr::kernel::TimeVaryingSupport::Fit(demonstrations, options);

  const std::vector<double> b0 = {-3.0};
  const std::vector<double> b1 = {3.0};
  std::printf("                    g(B_0)   g(B_1)\n");
  std::printf("pooled            %8.3f %8.3f\n", pooled.Decision(0, b0), pooled.Decision(0, b1));
  std::printf("time step 0       %8.3f %8.3f\n", varying.Decision(0, b0), varying.Decision(0, b1));
  std::printf("time step 1       %8.3f %8.3f\n", varying.Decision(1, b0), varying.Decision(1, b1));
  const bool missed = pooled.Decision(0, b0) < 0.0;
  const bool held = varying.Decision(0, b0) > 0.0 && varying.Decision(1, b1) > 0.0;
  return missed && held ? 0 : 1;
}
