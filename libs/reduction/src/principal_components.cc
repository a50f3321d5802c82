#include "dfr/reduction/principal_components.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include "dfr/core/contract.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/random.h"
#include "dfr/core/workers.h"

namespace dfr::reduction {
namespace {

using FloatRows = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Number of entries in a block of rows: large enough for fast products, small compared with the
// components.
constexpr Eigen::Index kBlockEntries = 1 << 22;
// Number of rows or columns of a job. Jobs are the same for any number of threads.
constexpr Eigen::Index kJobRows = 64;
constexpr Eigen::Index kJobColumns = 512;
// An entry varies if its standard deviation exceeds this fraction of its mean.
constexpr double kConstant = 1e-9;
// A direction is noise if its standard deviation is below this fraction of the largest: products in
// float have such rounding errors.
constexpr double kNoise = 1e-5;

Eigen::Index BlockRows(const RowSource& source) {
  return std::clamp<Eigen::Index>(kBlockEntries / source.width(), 1, source.rows());
}

// Calls job(first, count) for consecutive parts of [0, total).
void InParts(core::Workers& workers, Eigen::Index total, Eigen::Index part,
             const std::function<void(Eigen::Index, Eigen::Index)>& job) {
  workers.Run(static_cast<std::size_t>((total + part - 1) / part), [&](std::size_t i) {
    const Eigen::Index first = static_cast<Eigen::Index>(i) * part;
    job(first, std::min(part, total - first));
  });
}

void RefuseNonFinite(const core::Matrix& block, Eigen::Index first) {
  if (block.allFinite()) return;
  for (Eigen::Index i = 0; i < block.rows(); ++i) {
    for (Eigen::Index j = 0; j < block.cols(); ++j) {
      DFR_THROW_UNLESS(std::isfinite(block(i, j)),
                       "entry " << j << " of row " << first + i << " is not finite");
    }
  }
}

// Computes mean and scale in two passes. A single pass would lose digits if the mean is large.
void FitScale(const RowSource& source, double floor, core::Workers& workers,
              PrincipalComponents& fit) {
  const Eigen::Index n = source.rows();
  const Eigen::Index d = source.width();
  core::Matrix block(BlockRows(source), d);
  const auto for_each_block = [&](const std::function<void(Eigen::Index, Eigen::Index)>& add) {
    for (Eigen::Index first = 0; first < n; first += block.rows()) {
      if (n - first < block.rows()) block.resize(n - first, d);
      source.Read(first, block);
      RefuseNonFinite(block, first);
      InParts(workers, d, kJobColumns, add);
    }
    block.resize(BlockRows(source), d);
  };
  fit.mean = Eigen::VectorXd::Zero(d);
  for_each_block([&](Eigen::Index column, Eigen::Index count) {
    fit.mean.segment(column, count) += block.middleCols(column, count).colwise().sum().transpose();
  });
  fit.mean /= static_cast<double>(n);
  Eigen::VectorXd variance = Eigen::VectorXd::Zero(d);
  for_each_block([&](Eigen::Index column, Eigen::Index count) {
    variance.segment(column, count) +=
        (block.middleCols(column, count).rowwise() - fit.mean.segment(column, count).transpose())
            .colwise()
            .squaredNorm()
            .transpose();
  });
  variance /= static_cast<double>(n);
  const Eigen::VectorXd sd = variance.cwiseSqrt();
  // Entries have different units, so each is compared with its own mean.
  const Eigen::Array<bool, Eigen::Dynamic, 1> varies =
      sd.array() > kConstant * fit.mean.array().abs();
  const auto varying = static_cast<double>(varies.count());
  DFR_THROW_UNLESS(varying > 0.0 && sd.maxCoeff() > 0.0,
                   "all " << n << " rows are equal: there is nothing to reduce");
  const double least = floor * std::sqrt(varies.select(variance.array(), 0.0).sum() / varying);
  fit.scale = varies.select(sd.array().max(least), 0.0);
}

// Products with the standardised rows A.
class Standardised {
 public:
  Standardised(const RowSource& source, const PrincipalComponents& fit, core::Workers& workers)
      : source_(source),
        workers_(workers),
        mean_(fit.mean),
        inverse_scale_((fit.scale.array() > 0.0).select(fit.scale.cwiseInverse(), 0.0)) {}

  // Returns A Q, n x l.
  [[nodiscard]] FloatRows Times(const FloatRows& q) {
    FloatRows product(source_.rows(), q.cols());
    ForEachBlock([&](Eigen::Index first, const FloatRows& a) {
      InParts(workers_, a.rows(), kJobRows, [&](Eigen::Index row, Eigen::Index count) {
        product.middleRows(first + row, count).noalias() = a.middleRows(row, count) * q;
      });
    });
    return product;
  }

  // Returns A' (A Q) / n, d x l.
  [[nodiscard]] FloatRows Covariance(const FloatRows& q) {
    FloatRows sum = FloatRows::Zero(q.rows(), q.cols());
    FloatRows product;
    ForEachBlock([&](Eigen::Index, const FloatRows& a) {
      product.resize(a.rows(), q.cols());
      InParts(workers_, a.rows(), kJobRows, [&](Eigen::Index row, Eigen::Index count) {
        product.middleRows(row, count).noalias() = a.middleRows(row, count) * q;
      });
      InParts(workers_, q.rows(), kJobColumns, [&](Eigen::Index column, Eigen::Index count) {
        sum.middleRows(column, count).noalias() +=
            a.middleCols(column, count).transpose() * product;
      });
    });
    return sum / static_cast<float>(source_.rows());
  }

 private:
  void ForEachBlock(const std::function<void(Eigen::Index, const FloatRows&)>& use) {
    core::Matrix block(BlockRows(source_), source_.width());
    FloatRows a(block.rows(), block.cols());
    for (Eigen::Index first = 0; first < source_.rows(); first += block.rows()) {
      const Eigen::Index count = std::min(block.rows(), source_.rows() - first);
      if (count < block.rows()) {
        block.resize(count, Eigen::NoChange);
        a.resize(count, Eigen::NoChange);
      }
      source_.Read(first, block);
      InParts(workers_, count, kJobRows, [&](Eigen::Index row, Eigen::Index rows) {
        a.middleRows(row, rows) = ((block.middleRows(row, rows).rowwise() - mean_.transpose()) *
                                   inverse_scale_.asDiagonal())
                                      .cast<float>();
      });
      use(first, a);
    }
  }

  const RowSource& source_;
  core::Workers& workers_;
  const Eigen::VectorXd& mean_;
  Eigen::VectorXd inverse_scale_;
};

// Returns an orthonormal basis of the columns.
FloatRows Orthonormal(const FloatRows& columns) {
  return core::OrthonormalBasis(columns.cast<double>()).cast<float>();
}

}  // namespace

PrincipalComponents FitPrincipalComponents(const RowSource& source,
                                           const PrincipalComponentsOptions& options) {
  DFR_THROW_UNLESS(options.components >= 1,
                   "components must be at least 1, not " << options.components);
  DFR_THROW_UNLESS(options.oversampling >= 0 && options.power_iterations >= 1,
                   "oversampling must be at least 0 and power_iterations at least 1, not "
                       << options.oversampling << " and " << options.power_iterations);
  DFR_THROW_UNLESS(options.scale_floor >= 0.0 && options.scale_floor <= 1.0,
                   "scale_floor must lie in [0, 1], not " << options.scale_floor);
  const Eigen::Index n = source.rows();
  DFR_THROW_UNLESS(n >= 2, "principal components need at least 2 rows, not " << n);
  core::Workers workers(options.threads);
  PrincipalComponents fit;
  FitScale(source, options.scale_floor, workers, fit);

  const Eigen::Index l =
      std::min<Eigen::Index>(static_cast<Eigen::Index>(options.components) + options.oversampling,
                             std::min(n, source.width()));
  core::Random random(options.seed);
  FloatRows q(source.width(), l);
  for (Eigen::Index i = 0; i < q.size(); ++i) q.data()[i] = static_cast<float>(random.Normal());
  q = Orthonormal(q);
  Standardised rows(source, fit, workers);
  for (int i = 0; i < options.power_iterations; ++i) {
    if (l < source.width()) q = Orthonormal(rows.Covariance(q));
  }
  const FloatRows product = rows.Times(q);
  Eigen::MatrixXd gram = Eigen::MatrixXd::Zero(l, l);
  for (Eigen::Index first = 0; first < n; first += kJobColumns) {
    const Eigen::MatrixXd part =
        product.middleRows(first, std::min(kJobColumns, n - first)).cast<double>();
    gram += core::Multiply(part.transpose(), part);
  }
  const core::SymmetricEigen eigen = core::DecomposeSymmetric(gram / static_cast<double>(n));
  const Eigen::VectorXd variance = eigen.values.reverse();
  Eigen::Index kept = 0;
  while (kept < std::min<Eigen::Index>(l, options.components) &&
         variance[kept] > kNoise * kNoise * variance[0]) {
    ++kept;
  }
  Eigen::MatrixXd rotation = eigen.vectors.rowwise().reverse().leftCols(kept);
  fit.variance = variance.head(kept);
  const Eigen::MatrixXd basis = q.cast<double>();
  fit.components = core::Multiply(rotation.transpose(), basis.transpose());
  for (Eigen::Index i = 0; i < source.width(); ++i) {
    if (fit.scale[i] == 0.0)
      fit.components.col(i).setZero();  // Removes the rounding errors of the random start.
  }
  for (Eigen::Index k = 0; k < kept; ++k) {
    Eigen::Index largest = 0;
    fit.components.row(k).cwiseAbs().maxCoeff(&largest);
    if (fit.components(k, largest) < 0.0) {
      fit.components.row(k) *= -1.0;
      rotation.col(k) *= -1.0;
    }
  }
  fit.scores.resize(n, kept);
  for (Eigen::Index first = 0; first < n; first += kJobColumns) {
    const Eigen::Index count = std::min(kJobColumns, n - first);
    fit.scores.middleRows(first, count) =
        core::Multiply(product.middleRows(first, count).cast<double>(), rotation);
  }
  return fit;
}

}  // namespace dfr::reduction
