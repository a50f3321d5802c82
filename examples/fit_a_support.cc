// Fits the support of a sample cloud, evaluates it and saves it. Prints the results; exits 1 if
// they are wrong.
#include <cstdio>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/kernel/libsvm_io.h"
#include "dfr/kernel/one_class_svm.h"

int main() {
  // 500 states of two entries, one per row.
  dfr::core::Random random(/*seed=*/1);
  dfr::core::Matrix states(500, 2);
  for (Eigen::Index i = 0; i < states.size(); ++i) states.data()[i] = random.Normal();

  // nu bounds the fraction of states outside; gamma is in 1 / (state unit)^2.
  const auto support = dfr::kernel::OneClassSvm::Fit(states, {.nu = 0.05, .gamma = 0.5});

  const std::vector<double> near = {0.1, -0.2};
  const std::vector<double> far = {4.0, 4.0};
  std::printf("g(near) = %.3f, g(far) = %.3f\n", support.Decision(near), support.Decision(far));

  // l, the log form of g, distinguishes near from far outside, and its gradient points back.
  std::vector<double> back(2);
  const double level = support.LogGradient(far, back);
  std::printf("l(far) = %.1f, the way back is (%.2f, %.2f)\n", level, back[0], back[1]);

  dfr::kernel::SaveLibsvmModel(support, "support.model");  // svm-predict reads it
  return support.Decision(near) > 0.0 && support.Decision(far) < 0.0 && back[0] < 0.0 ? 0 : 1;
}
