#include "apps/study/planar/polynomial_policy.h"

#include <algorithm>
#include <array>

#include "dfr/core/contract.h"
#include "dfr/core/numerics/linear_algebra.h"

namespace dfr::study::planar {

PolynomialPolicy::PolynomialPolicy(std::span<const core::Trajectory> demonstrations, int degree)
    : degree_(degree) {
  DFR_THROW_UNLESS(degree >= 1 && degree <= 3, "degree must be 1, 2 or 3, not " << degree);
  DFR_THROW_UNLESS(!demonstrations.empty(), "there are no demonstrations");
  const Eigen::Index n = demonstrations[0].states.cols();
  const Eigen::Index m = demonstrations[0].controls.cols();
  DFR_THROW_UNLESS(n <= kMaxStateDim,
                   "at most " << kMaxStateDim << " state entries are supported, not " << n);
  Eigen::Index rows = 0;
  for (const auto& d : demonstrations) rows += d.controls.rows();
  DFR_THROW_UNLESS(rows > 0, "no demonstration has a control");
  core::Matrix x(rows, n);
  core::Matrix u(rows, m);
  Eigen::Index row = 0;
  for (const auto& d : demonstrations) {
    x.middleRows(row, d.controls.rows()) = d.states.topRows(d.controls.rows());
    u.middleRows(row, d.controls.rows()) = d.controls;
    row += d.controls.rows();
  }
  mean_ = x.colwise().mean();
  scale_ = ((x.rowwise() - mean_.transpose()).colwise().squaredNorm() / static_cast<double>(rows))
               .cwiseSqrt()
               .cwiseMax(1e-9);
  std::array<double, kMaxTerms> terms;
  const int count = Terms(core::Row(x, 0), terms);
  core::Matrix a = 1e-3 * core::Matrix::Identity(count, count);
  core::Matrix b = core::Matrix::Zero(count, m);
  for (Eigen::Index i = 0; i < rows; ++i) {
    Terms(core::Row(x, i), terms);
    const Eigen::Map<const Eigen::VectorXd> phi(terms.data(), count);
    a += phi * phi.transpose();
    b += phi * u.row(i);
  }
  weights_ = core::SolveSymmetric(a, b);
}

int PolynomialPolicy::Terms(std::span<const double> x, std::span<double> terms) const noexcept {
  std::array<double, kMaxStateDim> y;
  const std::size_t n = x.size();
  for (std::size_t i = 0; i < n; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    y[i] = (x[i] - mean_[k]) / scale_[k];
  }
  std::size_t count = 0;
  terms[count++] = 1.0;
  for (std::size_t i = 0; i < n; ++i) {
    terms[count++] = y[i];
    for (std::size_t j = 0; j <= i && degree_ >= 2; ++j) {
      terms[count++] = y[i] * y[j];
      for (std::size_t k = 0; k <= j && degree_ >= 3; ++k) terms[count++] = y[i] * y[j] * y[k];
    }
  }
  return static_cast<int>(count);
}

void PolynomialPolicy::Control(int /*t*/, std::span<const double> x,
                               std::span<double> u) const noexcept {
  std::array<double, kMaxTerms> terms;
  const int count = Terms(x, terms);
  core::AsVector(u).noalias() =
      weights_.transpose().lazyProduct(Eigen::Map<const Eigen::VectorXd>(terms.data(), count));
  for (double& entry : u) entry = std::clamp(entry, -1.0, 1.0);
}

}  // namespace dfr::study::planar
