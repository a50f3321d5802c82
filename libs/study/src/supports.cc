#include "dfr/study/supports.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "dfr/control/published/lambda.h"
#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/numerics/quantile.h"
#include "dfr/core/text/suggest.h"
#include "dfr/study/policies.h"
#include "nearest_rows.h"

namespace dfr::study {
namespace {

constexpr double kNu = 0.05;
constexpr int kWindow = 2;
constexpr double kNever = -std::numeric_limits<double>::infinity();

// Demonstrated features, pooled over time steps t - kWindow ... t + kWindow. A demonstration keeps
// its last state after its end.
class Pooled : public core::LogDecisionFunction {
 public:
  [[nodiscard]] int state_dim() const noexcept final { return static_cast<int>(points_[0].cols()); }
  [[nodiscard]] int num_steps() const noexcept final { return static_cast<int>(points_.size()); }
  [[nodiscard]] double Decision(int t, std::span<const double> z) const noexcept final {
    return FromLog(t, LogDecision(t, z, {}));
  }
  double Gradient(int t, std::span<const double> z,
                  std::span<double> gradient) const noexcept final {
    const double g = FromLog(t, LogDecision(t, z, gradient));
    if (g != kNever) {
      for (double& entry : gradient) entry *= 1.0 + g;  // (e^l - 1)' = e^l l'
    }
    return g;
  }
  [[nodiscard]] double FromLog(int /*t*/, double l) const noexcept final {
    return l == kNever ? l : std::expm1(l);
  }
  double LogDecision(int t, std::span<const double> z,
                     std::span<double> gradient) const noexcept final {
    std::ranges::fill(gradient, 0.0);
    if (std::ssize(z) != state_dim() ||
        !std::ranges::all_of(z, [](double entry) { return std::isfinite(entry); })) {
      return kNever;
    }
    const double l = Level(Clamped(t), z, gradient, -1);
    if (std::isfinite(l)) return l;
    std::ranges::fill(gradient, 0.0);
    return kNever;
  }

 protected:
  Pooled(const core::FeatureTransform& features, std::span<const core::Trajectory> demonstrations) {
    std::vector<core::Matrix> z;
    Eigen::Index longest = 0;
    for (const core::Trajectory& d : demonstrations) {
      z.push_back(features.Apply(d.states));
      longest = std::max(longest, d.states.rows());
    }
    const auto count = static_cast<Eigen::Index>(z.size());
    for (Eigen::Index t = 0; t < longest; ++t) {
      core::Matrix points((2 * kWindow + 1) * count, features.num_features());
      for (Eigen::Index row = 0; row < points.rows(); ++row) {
        const core::Matrix& states = z[static_cast<std::size_t>(row % count)];
        points.row(row) =
            states.row(std::clamp<Eigen::Index>(t + row / count - kWindow, 0, states.rows() - 1));
      }
      points_.push_back(std::move(points));
    }
    demonstrations_ = count;
  }

  // Returns l_t, and writes its gradient unless `gradient` is empty. Leaves out the states of
  // demonstration `without`, or none for -1. q_ holds a provisional value until it is fitted.
  virtual double Level(std::size_t t, std::span<const double> z, std::span<double> gradient,
                       Eigen::Index without) const noexcept = 0;

  // Returns the nu-quantile of l over the demonstrated states of time step t alone.
  [[nodiscard]] double LevelQuantile(std::size_t t) const {
    std::vector<double> levels;
    for (Eigen::Index d = 0; d < demonstrations_; ++d) {
      const Eigen::Index own = kWindow * demonstrations_ + d;
      levels.push_back(Level(t, core::Row(points_[t], own), {}, d));
    }
    return core::Quantile(levels, kNu);
  }

  [[nodiscard]] bool Counts(Eigen::Index row, Eigen::Index without) const noexcept {
    return row % demonstrations_ != without;
  }
  [[nodiscard]] std::size_t Clamped(int t) const noexcept {
    return static_cast<std::size_t>(std::clamp(t, 0, num_steps() - 1));
  }

  std::vector<core::Matrix> points_;
  std::vector<double> q_;  // per time step

 private:
  Eigen::Index demonstrations_ = 0;
};

class KnnDistance final : public Pooled {
 public:
  KnnDistance(const core::FeatureTransform& features,
              std::span<const core::Trajectory> demonstrations)
      : Pooled(features, demonstrations) {
    q_.assign(points_.size(), 1.0);
    for (std::size_t t = 0; t < points_.size(); ++t) q_[t] = std::max(1e-9, 1.0 - LevelQuantile(t));
  }
  // The mean distance to the nearest states is the minimum over all choices of as many states, and
  // each choice has this curvature.
  [[nodiscard]] double curvature_bound(int t) const noexcept override {
    return 1.0 / q_[Clamped(t)];
  }

 private:
  static constexpr std::size_t kNeighbours = 5;

  double Level(std::size_t t, std::span<const double> z, std::span<double> gradient,
               Eigen::Index without) const noexcept override {
    const core::Matrix& points = points_[t];
    const auto nearest = internal::NearestRows<kNeighbours>(
        points, 0, points.rows(), z, [&](Eigen::Index row) { return Counts(row, without); });
    const double scale = 1.0 / (static_cast<double>(kNeighbours) * q_[t]);
    double l = 1.0;
    for (const auto& [distance, row] : nearest) {
      l -= scale * distance;
      if (gradient.empty() || row < 0) continue;
      core::AsVector(gradient) -= 2.0 * scale * (core::AsVector(z) - points.row(row).transpose());
    }
    return l;
  }
};

class Density final : public Pooled {
 public:
  Density(const core::FeatureTransform& features, std::span<const core::Trajectory> demonstrations)
      : Pooled(features, demonstrations) {
    // Silverman's width for features of unit variance.
    const double n = static_cast<double>(demonstrations.size());
    const double d = state_dim();
    width_ = std::pow(4.0 / ((d + 2.0) * n), 1.0 / (d + 4.0));
    q_.assign(points_.size(), 0.0);
    for (std::size_t t = 0; t < points_.size(); ++t) q_[t] = LevelQuantile(t);
  }
  // The log of a mixture curves downwards at most as much as the log of one of its Gaussians.
  [[nodiscard]] double curvature_bound(int /*t*/) const noexcept override {
    return 0.5 / (width_ * width_);
  }

 private:
  double Level(std::size_t t, std::span<const double> z, std::span<double> gradient,
               Eigen::Index without) const noexcept override {
    const core::Matrix& points = points_[t];
    const double scale = 1.0 / (width_ * width_);
    double largest = kNever;
    for (Eigen::Index row = 0; row < points.rows(); ++row) {
      if (!Counts(row, without)) continue;
      largest = std::max(
          largest, -0.5 * scale * (points.row(row).transpose() - core::AsVector(z)).squaredNorm());
    }
    double sum = 0.0;
    double count = 0.0;
    for (Eigen::Index row = 0; row < points.rows(); ++row) {
      if (!Counts(row, without)) continue;
      const double exponent =
          -0.5 * scale * (points.row(row).transpose() - core::AsVector(z)).squaredNorm();
      const double weight = std::exp(exponent - largest);
      sum += weight;
      count += 1.0;
      if (gradient.empty()) continue;
      core::AsVector(gradient) +=
          weight * scale * (points.row(row).transpose() - core::AsVector(z));
    }
    for (double& entry : gradient) entry /= sum;
    return largest + std::log(sum / count) - q_[t];
  }

  double width_ = 1.0;
};

class Mahalanobis final : public Pooled {
 public:
  Mahalanobis(const core::FeatureTransform& features,
              std::span<const core::Trajectory> demonstrations)
      : Pooled(features, demonstrations) {
    constexpr double kRidge = 0.03;
    for (const core::Matrix& points : points_) {
      means_.emplace_back(points.colwise().mean());
      const core::Matrix centred = points.rowwise() - means_.back().transpose();
      const Eigen::MatrixXd covariance =
          core::Matrix(centred.transpose() * centred) / static_cast<double>(points.rows()) +
          kRidge * Eigen::MatrixXd::Identity(points.cols(), points.cols());
      precisions_.emplace_back(core::PseudoInverse(covariance));
      largest_.push_back(core::DecomposeSymmetric(precisions_.back()).values.maxCoeff());
    }
    q_.assign(points_.size(), 1.0);
    for (std::size_t t = 0; t < points_.size(); ++t) q_[t] = std::max(1e-9, 1.0 - LevelQuantile(t));
  }
  [[nodiscard]] double curvature_bound(int t) const noexcept override {
    return largest_[Clamped(t)] / q_[Clamped(t)];
  }

 private:
  double Level(std::size_t t, std::span<const double> z, std::span<double> gradient,
               Eigen::Index /*without*/) const noexcept override {
    // Computes the product entry by entry, to avoid allocation.
    double square = 0.0;
    const Eigen::MatrixXd& precision = precisions_[t];
    for (Eigen::Index i = 0; i < precision.rows(); ++i) {
      double product = 0.0;
      for (Eigen::Index k = 0; k < precision.cols(); ++k) {
        product += precision(i, k) * (z[static_cast<std::size_t>(k)] - means_[t][k]);
      }
      square += product * (z[static_cast<std::size_t>(i)] - means_[t][i]);
      if (!gradient.empty()) gradient[static_cast<std::size_t>(i)] = -2.0 * product / q_[t];
    }
    return 1.0 - square / q_[t];
  }

  std::vector<Eigen::VectorXd> means_;
  std::vector<Eigen::MatrixXd> precisions_;
  std::vector<double> largest_;
};

}  // namespace

SupportModel::SupportModel(std::string_view name, const FittedTask& fit,
                           const core::StateLayout& layout,
                           std::span<const core::Trajectory> demonstrations)
    : features_(fit.model().features()) {
  const safety::TaskModel& task = fit.model();
  if (name == "raw") {
    DFR_THROW_UNLESS(task.published() != nullptr, "this task has no raw support");
    features_ = core::FeatureTransform::Identity(
        task.published_features().empty()
            ? core::FeatureSelection::All(layout.state_dim())
            : core::FeatureSelection(layout, task.published_features()));
    support_ = task.published();
  } else if (name == "whitened") {
    support_ = &task.feature_support();
  } else if (name == "knn-distance") {
    own_ = std::make_unique<KnnDistance>(features_, demonstrations);
  } else if (name == "density") {
    own_ = std::make_unique<Density>(features_, demonstrations);
  } else if (name == "mahalanobis") {
    own_ = std::make_unique<Mahalanobis>(features_, demonstrations);
  } else {
    throw core::UnknownName("support", name, Join(kSupports));
  }
  if (own_ != nullptr) support_ = own_.get();
  const control::FeatureTrajectories seen(features_, fit.Measured(demonstrations));
  levels_.emplace(*support_, seen.points, control::LevelOptions{.slack = task.levels().slack()});
  response_.emplace(seen);
  decision_.emplace(features_, *support_);
  lambda_ = control::EstimateLambda(*decision_, demonstrations);
}

SupportModel::~SupportModel() = default;

}  // namespace dfr::study
