// Decisions of a one-class SVM: compares every instruction set with a sum in extended precision.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <span>
#include <stdexcept>

#include "dfr/kernel/one_class_svm.h"
#include "gaussian/gaussian_sum.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

namespace {

// Makes doubles of any size from bytes. Nonfinite values become 0.
class Numbers {
 public:
  Numbers(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {}
  double Next() {
    std::int16_t mantissa = 0;
    if (position_ + sizeof mantissa + 1 > size_)
      return 0.25 * static_cast<double>(++position_ % 7U);
    std::memcpy(&mantissa, data_ + position_, sizeof mantissa);
    const int byte = data_[position_ + 2];
    const int exponent = byte < 128 ? byte : byte - 256;
    position_ += 3;
    return std::ldexp(static_cast<double>(mantissa), exponent / 4 - 14);
  }

 private:
  const std::uint8_t* data_;
  std::size_t size_;
  std::size_t position_ = 0;
};

}  // namespace

DFR_FUZZ_TARGET(decisions) {
  if (size < 4) return 0;
  const Eigen::Index terms = 1 + data[0] % 40;
  const Eigen::Index dim = 1 + data[1] % 12;
  const double gamma = std::ldexp(1.0, data[2] % 24 - 12);
  Numbers numbers(data + 3, size - 3);
  dfr::core::Matrix vectors(terms, dim);
  for (double& entry : vectors.reshaped()) entry = numbers.Next();
  Eigen::VectorXd alpha(terms);
  for (double& entry : alpha) entry = 1e-3 + std::min(std::abs(numbers.Next()), 1.0);
  alpha /= alpha.sum();
  Eigen::VectorXd state(dim);
  for (double& entry : state) entry = numbers.Next();

  // Coordinates are relative to one centre, in kernel widths. The rounding error of a coordinate is
  // its size times epsilon, and the kernel falls by less than 1 per width.
  double widths = 0.0;
  for (Eigen::Index k = 0; k < dim; ++k) {
    widths += std::sqrt(2.0 * gamma) * (vectors.col(k).maxCoeff() - vectors.col(k).minCoeff());
  }
  const double tolerance = 1e-13 + 2.0 * std::numeric_limits<double>::epsilon() * widths;
  long double expected = 0.0L;
  for (Eigen::Index i = 0; i < terms; ++i) {
    long double square = 0.0L;
    for (Eigen::Index k = 0; k < dim; ++k) {
      const long double d = static_cast<long double>(state[k]) - vectors(i, k);
      square += d * d;
    }
    expected += static_cast<long double>(alpha[i]) * std::exp(-gamma * square);
  }
  for (const std::int64_t target : dfr::kernel::internal::SupportedTargets()) {
    dfr::kernel::internal::ForceTarget(target);
    try {
      const auto svm = dfr::kernel::OneClassSvm::FromParts(vectors, alpha, gamma, 0.0, 1.0);
      const double g = svm.Decision(dfr::core::AsSpan(state));
      // alpha sums to 1. The rounding of the distance has the weight gamma |d|^2 e^{-gamma |d|^2}
      // <= 1/e.
      if (!(std::abs(g - static_cast<double>(expected)) <= tolerance)) {
        std::fprintf(stderr, "%s: %.17g, expected %.17Lg\n",
                     dfr::kernel::internal::TargetName(target), g, expected);
        std::abort();
      }
    } catch (const std::invalid_argument&) {  // NOLINT(bugprone-empty-catch): too far apart
    }
  }
  dfr::kernel::internal::ForceTarget(0);
  return 0;
}
