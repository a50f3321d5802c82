#include <array>

#include "dfr/core/random.h"
#include "dfr/kernel/one_class_svm.h"

// Fits a support to a cloud around the origin: its centre is inside, a far state is not.
int main() {
  dfr::core::Random random(1);
  dfr::core::Matrix samples(200, 2);
  for (Eigen::Index i = 0; i < samples.size(); ++i) samples.data()[i] = random.Normal();
  const auto support = dfr::kernel::OneClassSvm::Fit(samples, {.nu = 0.05, .gamma = 0.5});
  const bool inside = support.Decision(std::array{0.0, 0.0}) > 0.0;
  const bool outside = support.Decision(std::array{9.0, 0.0}) < 0.0;
  return inside && outside ? 0 : 1;
}
