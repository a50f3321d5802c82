#include <array>

#include "dfr/kernel/one_class_svm.h"

// Fits a support to a square: the square's centre is inside, and a far state is outside.
int main() {
  const dfr::core::Matrix samples = Eigen::MatrixXd::Random(200, 2);
  const auto support = dfr::kernel::OneClassSvm::Fit(samples, {.nu = 0.05, .gamma = 0.5});
  const bool inside = support.Decision(std::array{0.0, 0.0}) > 0.0;
  return inside && support.Decision(std::array{9.0, 0.0}) < 0.0 ? 0 : 1;
}
