#include "dfr/control/jacobian_estimate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "dfr/core/contract.h"

namespace dfr::control {
namespace {

// Transitions that one estimate may look at: their weights are kept on the stack.
constexpr int kMaxTransitions = 1024;

// Entries of features and of a control: each decision solves a problem of the size of the control.
constexpr int kMaxEntries = 256;

void Check(const JacobianOptions& options) {
  DFR_THROW_UNLESS(options.ridge > 0.0, "ridge must be positive, not " << options.ridge);
  DFR_THROW_UNLESS(options.prior_weight >= 0.0,
                   "prior_weight must not be negative: " << options.prior_weight);
  DFR_THROW_UNLESS(options.window >= 0, "window must not be negative: " << options.window);
  DFR_THROW_UNLESS(options.max_per_step > 0,
                   "max_per_step must be positive, not " << options.max_per_step);
  DFR_THROW_UNLESS(options.window < kMaxTransitions &&
                       options.max_per_step <= kMaxTransitions / (2 * options.window + 1),
                   "(2 window + 1) max_per_step must be at most "
                       << kMaxTransitions << "; window is " << options.window << ", max_per_step "
                       << options.max_per_step);
  DFR_THROW_UNLESS(options.forgetting >= 0.0 && options.forgetting < 1.0,
                   "forgetting must lie in [0, 1), not be " << options.forgetting);
}

}  // namespace

JacobianPrior::JacobianPrior(std::span<const core::Matrix> features,
                             std::span<const core::Matrix> controls, const JacobianOptions& options)
    : options_(options) {
  Check(options);
  DFR_THROW_UNLESS(!features.empty() && features.size() == controls.size(),
                   features.size()
                       << " demonstrations of features, " << controls.size() << " of controls");
  feature_dim_ = static_cast<int>(features[0].cols());
  control_dim_ = static_cast<int>(controls[0].cols());
  const int n = feature_dim_;
  const int m = control_dim_;
  DFR_THROW_UNLESS(n >= 1 && n <= kMaxEntries && m >= 1 && m <= kMaxEntries,
                   "features have " << n << " entries, controls " << m << "; from 1 to "
                                    << kMaxEntries << " are possible");
  Eigen::Index longest = 0;
  for (std::size_t d = 0; d < features.size(); ++d) {
    DFR_THROW_UNLESS(features[d].cols() == n && controls[d].cols() == m &&
                         features[d].rows() == controls[d].rows() + 1,
                     "demonstration " << d << ": features " << features[d].rows() << " x "
                                      << features[d].cols() << ", controls " << controls[d].rows()
                                      << " x " << controls[d].cols());
    longest = std::max(longest, controls[d].rows());
  }

  std::vector<std::pair<std::size_t, Eigen::Index>> chosen;
  std::vector<std::size_t> moving;
  for (Eigen::Index t = 0; t < longest; ++t) {
    begin_.push_back(static_cast<int>(chosen.size()));
    moving.clear();
    for (std::size_t d = 0; d < controls.size(); ++d) {
      if (t < controls[d].rows() && controls[d].row(t).squaredNorm() > 0.0) moving.push_back(d);
    }
    const std::size_t most =
        std::min<std::size_t>(moving.size(), static_cast<std::size_t>(options.max_per_step));
    for (std::size_t i = 0; i < most; ++i) chosen.emplace_back(moving[i * moving.size() / most], t);
  }
  begin_.push_back(static_cast<int>(chosen.size()));

  const auto rows = static_cast<Eigen::Index>(chosen.size());
  points_.resize(rows, n);
  controls_.resize(rows, m);
  products_.resize(rows, m * (m + 1) / 2 + m * n);
  for (Eigen::Index row = 0; row < rows; ++row) {
    const auto [d, t] = chosen[static_cast<std::size_t>(row)];
    points_.row(row) = features[d].row(t).cast<float>();
    controls_.row(row) = controls[d].row(t).cast<float>();
    Eigen::Index column = 0;
    for (int i = 0; i < m; ++i) {
      for (int j = 0; j <= i; ++j) {
        products_(row, column++) = static_cast<float>(controls[d](t, i) * controls[d](t, j));
      }
    }
    for (int k = 0; k < n; ++k) {
      for (int i = 0; i < m; ++i) {
        products_(row, column++) =
            static_cast<float>(controls[d](t, i) * (features[d](t + 1, k) - features[d](t, k)));
      }
    }
  }
}

void JacobianPrior::Save(core::ArchiveWriter& archive) const {
  archive.Number(options_.ridge);
  archive.Number(options_.prior_weight);
  archive.Integer(options_.window);
  archive.Integer(options_.max_per_step);
  archive.Number(options_.forgetting);
  archive.Integer(feature_dim_);
  archive.Integer(control_dim_);
  archive.Integers(begin_);
  archive.MatrixBlock(points_.cast<double>());
  archive.MatrixBlock(controls_.cast<double>());
  archive.MatrixBlock(products_.cast<double>());
}

JacobianPrior JacobianPrior::Load(core::ArchiveReader& archive) {
  constexpr int kWithControls = 3;  // The first version of files that hold controls_.
  JacobianPrior prior;
  try {
    prior.options_.ridge = archive.Number();
    prior.options_.prior_weight = archive.Number();
    prior.options_.window = archive.IntegerIn(0, kMaxTransitions);
    prior.options_.max_per_step = archive.IntegerIn(1, kMaxTransitions);
    prior.options_.forgetting = archive.Number();
    Check(prior.options_);
    prior.feature_dim_ = archive.IntegerIn(1, kMaxEntries);
    prior.control_dim_ = archive.IntegerIn(1, kMaxEntries);
    prior.begin_ = archive.Integers();
    prior.points_ = archive.MatrixBlock().cast<float>();
    const bool has_controls = archive.version() >= kWithControls;
    if (has_controls) prior.controls_ = archive.MatrixBlock().cast<float>();
    prior.products_ = archive.MatrixBlock().cast<float>();
    const std::vector<int>& begin = prior.begin_;
    DFR_THROW_UNLESS(
        begin.size() >= 2 && begin.front() == 0 && begin.back() == prior.points_.rows(),
        "the transitions of the Jacobian prior do not begin and end where they should");
    for (std::size_t t = 1; t < begin.size(); ++t) {
      DFR_THROW_UNLESS(
          begin[t] >= begin[t - 1] && begin[t] - begin[t - 1] <= prior.options_.max_per_step,
          "time step " << t - 1 << " of the Jacobian prior has " << begin[t] - begin[t - 1]
                       << " transitions");
    }
    const Eigen::Index n = prior.feature_dim_;
    const Eigen::Index m = prior.control_dim_;
    DFR_THROW_UNLESS(prior.points_.cols() == n && prior.products_.rows() == prior.points_.rows() &&
                         prior.products_.cols() == m * (m + 1) / 2 + m * n &&
                         (!has_controls || (prior.controls_.rows() == prior.points_.rows() &&
                                            prior.controls_.cols() == m)),
                     "the matrices of the Jacobian prior do not fit each other");
    DFR_THROW_UNLESS(
        prior.points_.allFinite() && prior.controls_.allFinite() && prior.products_.allFinite(),
        "the Jacobian prior has a non-finite entry");
  } catch (const std::invalid_argument& e) {
    archive.Fail(e.what());
  }
  return prior;
}

std::pair<int, int> JacobianPrior::Near(int t) const noexcept {
  const int steps = static_cast<int>(begin_.size()) - 1;
  return {begin_[static_cast<std::size_t>(std::clamp(t - options_.window, 0, steps))],
          begin_[static_cast<std::size_t>(std::clamp(t + options_.window + 1, 0, steps))]};
}

void JacobianPrior::AddTo(int t, std::span<const double> z, Eigen::VectorXf& sums,
                          Eigen::MatrixXd& a, Eigen::MatrixXd& b) const noexcept {
  const auto [first, last] = Near(t);
  const int n = feature_dim_;
  const int m = control_dim_;
  const Eigen::Index rows = last - first;
  if (rows <= 0) return;
  std::array<float, kMaxTransitions> buffer;
  Eigen::Map<Eigen::ArrayXf> weights(buffer.data(), rows);
  weights.setZero();
  for (int k = 0; k < n; ++k) {
    const auto z_k = static_cast<float>(z[static_cast<std::size_t>(k)]);
    weights += (points_.col(k).segment(first, rows).array() - z_k).square();
  }
  weights = 1e-6F + (-0.125F / static_cast<float>(n) * weights).exp();
  weights *= static_cast<float>(options_.prior_weight) / weights.sum();
  // Most of the work of an estimate.
  sums.noalias() = products_.middleRows(first, rows).transpose() * weights.matrix();
  const float* sum = sums.data();
  for (int i = 0; i < m; ++i) {
    for (int j = 0; j <= i; ++j) a(i, j) += *sum++;
  }
  for (int k = 0; k < n; ++k) {
    for (int i = 0; i < m; ++i) b(i, k) += *sum++;
  }
}

double JacobianPrior::AddDemonstrated(int t, std::span<const double> z, Eigen::VectorXd& y,
                                      Eigen::MatrixXd& a, Eigen::MatrixXd& b) const noexcept {
  // Weights fall with the squared distance times this, per feature. Narrower follows the nearest
  // demonstrations more closely, their noise included; wider forgets where it is.
  constexpr float kBandwidth = 0.5F;
  // From the last time step on, its transitions are the nearest there are.
  const auto [first, last] = Near(std::min(t, static_cast<int>(begin_.size()) - 2));
  const Eigen::Index rows = last - first;
  if (rows <= 0 || controls_.rows() == 0) return 0.0;
  const int n = feature_dim_;
  std::array<float, kMaxTransitions> buffer;
  Eigen::Map<Eigen::ArrayXf> weights(buffer.data(), rows);
  weights.setZero();
  for (int k = 0; k < n; ++k) {
    const auto z_k = static_cast<float>(z[static_cast<std::size_t>(k)]);
    weights += (points_.col(k).segment(first, rows).array() - z_k).square();
  }
  weights = (-kBandwidth / static_cast<float>(n) * (weights - weights.minCoeff())).exp();
  y[0] = 1.0;
  for (Eigen::Index i = 0; i < rows; ++i) {
    const double weight = static_cast<double>(weights[i]);
    for (int k = 0; k < n; ++k) {
      y[k + 1] = static_cast<double>(points_(first + i, k)) - z[static_cast<std::size_t>(k)];
    }
    // The lower triangle is enough.
    for (Eigen::Index k = 0; k <= n; ++k)
      a.col(k).tail(n + 1 - k) += weight * y[k] * y.tail(n + 1 - k);
    for (int k = 0; k < control_dim_; ++k) {
      b.col(k) += weight * static_cast<double>(controls_(first + i, k)) * y;
    }
  }
  return static_cast<double>(weights.sum());
}

JacobianEstimate::JacobianEstimate(std::shared_ptr<const JacobianPrior> prior,
                                   const DriftTime& drift_time)
    : prior_(std::move(prior)),
      drift_time_(drift_time),
      drifts_(drift_time.rest > 0.0 || drift_time.travel > 0.0) {
  DFR_THROW_UNLESS(drift_time.rest >= 0.0 && std::isfinite(drift_time.rest) &&
                       drift_time.travel >= 0.0 && std::isfinite(drift_time.travel),
                   "drift times must not be negative, and finite: rest "
                       << drift_time.rest << ", travel " << drift_time.travel);
  const int n = prior_->feature_dim();
  const int m = prior_->control_dim();
  const int columns = m + (drifts_ ? 1 : 0);
  a_online_ = Eigen::MatrixXd::Zero(columns, columns);
  b_online_ = Eigen::MatrixXd::Zero(columns, n);
  a_ = Eigen::MatrixXd::Identity(columns, columns);
  b_ = Eigen::MatrixXd::Zero(columns, n);
  inverse_ = Eigen::MatrixXd::Identity(columns, columns);
  jacobian_ = Eigen::MatrixXd::Zero(n, m);
  drift_ = Eigen::VectorXd::Zero(n);
  regressor_ = Eigen::VectorXd::Zero(columns);
  cholesky_ = Eigen::LLT<Eigen::MatrixXd>(a_);
  direction_ = Eigen::VectorXd::Zero(m);
  scratch_ = Eigen::VectorXd::Zero(m);
  sums_ = Eigen::VectorXf::Zero(prior_->num_sums());
  y_ = Eigen::VectorXd::Zero(n + 1);
  unit_ = Eigen::MatrixXd::Zero(n + 1, 1);
  a_demo_ = Eigen::MatrixXd::Identity(n + 1, n + 1);
  b_demo_ = Eigen::MatrixXd::Zero(n + 1, m);
  cholesky_demo_ = Eigen::LLT<Eigen::MatrixXd>(a_demo_);
  h_ = Eigen::MatrixXd::Identity(m, m);
  cholesky_controls_ = Eigen::LLT<Eigen::MatrixXd>(h_);
  did_ = Eigen::MatrixXd::Zero(m, 1);
  wanted_ = Eigen::VectorXd::Zero(n);
}

void JacobianEstimate::Reset() noexcept {
  a_online_.setZero();
  b_online_.setZero();
}

void JacobianEstimate::Update(std::span<const double> v, std::span<const double> dz,
                              double weight) noexcept {
  const double keep = prior_->options().forgetting;
  a_online_ *= keep;
  b_online_ *= keep;
  const int m = prior_->control_dim();
  regressor_.head(m) = core::AsVector(v);
  if (drifts_) regressor_[m] = Time(regressor_.head(m).norm());
  a_online_.noalias() += weight * regressor_.lazyProduct(regressor_.transpose());
  b_online_.noalias() += weight * regressor_.lazyProduct(core::AsVector(dz).transpose());
}

void JacobianEstimate::Compute(int t, std::span<const double> z) noexcept {
  a_ = a_online_;
  a_.diagonal().array() += prior_->options().ridge;
  b_ = b_online_;
  prior_->AddTo(t, z, sums_, a_, b_);
  // Only the lower triangle is read.
  cholesky_.compute(a_);
  inverse_.setIdentity();
  cholesky_.solveInPlace(inverse_);
  const int m = prior_->control_dim();
  jacobian_.noalias() = b_.transpose().lazyProduct(inverse_.leftCols(m));
  if (drifts_) drift_.noalias() = b_.transpose().lazyProduct(inverse_.col(m));
}

bool JacobianEstimate::Demonstrated(int t, std::span<const double> z, Eigen::VectorXd& v) noexcept {
  // For the slopes, per unit of weight: where states hardly differ in a direction, the control does
  // not depend on it.
  constexpr double kRidge = 0.1;
  constexpr double kNearness = 0.03;
  const int n = prior_->feature_dim();
  const int m = prior_->control_dim();
  a_demo_.setZero();
  b_demo_.setZero();
  const double weight = prior_->AddDemonstrated(t, z, y_, a_demo_, b_demo_);
  if (weight <= 0.0) return false;
  a_demo_.diagonal().tail(n).array() += kRidge * weight;
  cholesky_demo_.compute(a_demo_);
  // At z itself, y is the first unit vector.
  unit_.setZero();
  unit_(0, 0) = 1.0;
  cholesky_demo_.solveInPlace(unit_);
  v.noalias() = b_demo_.transpose().lazyProduct(unit_.col(0));

  // What it did: J_demo v_d, J_demo of the demonstrations alone.
  h_ = (a_ - a_online_).topLeftCorner(m, m);
  cholesky_controls_.compute(h_);
  did_ = v;
  cholesky_controls_.solveInPlace(did_);
  wanted_.noalias() = (b_ - b_online_).topRows(m).transpose().lazyProduct(did_.col(0));
  if (drifts_) wanted_ -= Time(v.norm()) * drift_;
  h_.noalias() = jacobian_.transpose().lazyProduct(jacobian_);
  const double nearness = kNearness * h_.trace() / m;
  if (!(nearness > 0.0)) return true;
  h_.diagonal().array() += nearness;
  scratch_.noalias() = jacobian_.transpose().lazyProduct(wanted_);
  did_ = scratch_ + nearness * v;
  cholesky_controls_.compute(h_);
  cholesky_controls_.solveInPlace(did_);
  v = did_.col(0);
  return true;
}

void JacobianEstimate::AddEffect(const Eigen::VectorXd& v,
                                 Eigen::Ref<Eigen::VectorXd> z) const noexcept {
  z.noalias() += jacobian_.lazyProduct(v);
  if (drifts_) z += Time(v.norm()) * drift_;
}

double JacobianEstimate::Ignorance() const noexcept {
  return inverse_.diagonal().head(prior_->control_dim()).sum();
}

double JacobianEstimate::LeastKnown(std::span<double> direction) noexcept {
  // Power iteration: A^-1 is a few rows wide, and a direction that is nearly the least known is as
  // good as the least known.
  direction_.setConstant(1.0 / std::sqrt(static_cast<double>(direction_.size())));
  // Off the constant vector, which may by symmetry be orthogonal to the answer.
  for (Eigen::Index i = 0; i < direction_.size(); ++i) {
    direction_[i] += 0.01 * static_cast<double>(i);
  }
  const int m = prior_->control_dim();
  double value = 0.0;
  constexpr int kIterations = 30;
  for (int i = 0; i < kIterations; ++i) {
    scratch_.noalias() = inverse_.topLeftCorner(m, m).lazyProduct(direction_);
    value = scratch_.norm();
    direction_ = scratch_ / value;
  }
  // Time always passes forwards: [v; s] and [-v; s] are not known equally well.
  if (drifts_ && inverse_.row(m).head(m).dot(direction_) < 0.0) direction_ = -direction_;
  std::copy(direction_.begin(), direction_.end(), direction.begin());
  return value;
}

}  // namespace dfr::control
