#pragma once

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "dfr/core/decision_function.h"
#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"

namespace dfr::kernel {

/// Interface for support estimates of a sample cloud by any method, to compare with OneClassSvm.
/// Immutable after construction: concurrent calls are safe. No member allocates, locks or throws.
class SupportEstimate {
 public:
  virtual ~SupportEstimate() = default;
  [[nodiscard]] virtual int state_dim() const noexcept = 0;
  /// Returns g(x), positive inside; -infinity for a wrong size or a non-finite entry.
  [[nodiscard]] virtual double Decision(std::span<const double> x) const noexcept = 0;
  /// Returns g(x) and writes its derivative to `gradient`; zero where there is none.
  virtual double Gradient(std::span<const double> x, std::span<double> gradient) const noexcept = 0;
  /// Returns L with |g(x) - g(y)| <= L |x - y|.
  [[nodiscard]] virtual double lipschitz_bound() const noexcept = 0;
};

/// Adapter for a OneClassSvm or a kernel density.
class SvmEstimate final : public SupportEstimate {
 public:
  explicit SvmEstimate(OneClassSvm svm) : svm_(std::move(svm)) {}
  [[nodiscard]] int state_dim() const noexcept override { return svm_.state_dim(); }
  [[nodiscard]] double Decision(std::span<const double> x) const noexcept override {
    return svm_.Decision(x);
  }
  double Gradient(std::span<const double> x, std::span<double> gradient) const noexcept override {
    return svm_.Gradient(x, gradient);
  }
  [[nodiscard]] double lipschitz_bound() const noexcept override { return svm_.lipschitz_bound(); }
  [[nodiscard]] const OneClassSvm& svm() const noexcept { return svm_; }

 private:
  OneClassSvm svm_;
};

/// Fits a Gaussian kernel density with a quantile threshold. All samples have the weight 1/m. A
/// share nu of the samples have a density below rho, where each sample's density excludes the
/// sample itself. The result has the form and speed of a OneClassSvm.
/// @throws std::invalid_argument as OneClassSvm::Fit() does.
OneClassSvm FitKernelDensity(const Eigen::Ref<const core::Matrix>& samples, double nu,
                             double gamma);

/// Mahalanobis distance to a normal distribution: g(x) = r - sqrt((x - mean)' C^-1 (x - mean)). C
/// is the samples' covariance plus `ridge` times its mean variance on the diagonal. r leaves a
/// share nu of the samples outside.
class GaussianEstimate final : public SupportEstimate {
 public:
  /// @throws std::invalid_argument if there are fewer than 2 samples, one is not finite, nu is not
  ///   in (0, 1], ridge is negative, or C is singular (constant features need ridge > 0 and at
  ///   least one feature that varies).
  static GaussianEstimate Fit(const Eigen::Ref<const core::Matrix>& samples, double nu,
                              double ridge = 1e-6);

  [[nodiscard]] int state_dim() const noexcept override { return static_cast<int>(mean_.size()); }
  [[nodiscard]] double Decision(std::span<const double> x) const noexcept override;
  double Gradient(std::span<const double> x, std::span<double> gradient) const noexcept override;
  [[nodiscard]] double lipschitz_bound() const noexcept override { return lipschitz_bound_; }
  [[nodiscard]] double radius() const noexcept { return radius_; }

 private:
  GaussianEstimate() = default;
  Eigen::VectorXd mean_;
  core::Matrix root_;  // C^-1 = root' root
  double radius_ = 0.0;
  double lipschitz_bound_ = 0.0;
};

/// Distance to the k-th nearest sample: g(x) = r - d_k(x). r is such that a share nu of the samples
/// is farther than r from its k-th nearest other sample. 1-Lipschitz by the triangle inequality.
/// Scans all samples, which are a few hundred per time step.
class NeighbourEstimate final : public SupportEstimate {
 public:
  static constexpr int kMostNeighbours = 64;

  /// @throws std::invalid_argument if there are not more than k samples, one is not finite, nu is
  ///   not in (0, 1], or k is not in [1, kMostNeighbours].
  static NeighbourEstimate Fit(const Eigen::Ref<const core::Matrix>& samples, double nu, int k = 5);

  [[nodiscard]] int state_dim() const noexcept override {
    return static_cast<int>(samples_.cols());
  }
  [[nodiscard]] double Decision(std::span<const double> x) const noexcept override;
  double Gradient(std::span<const double> x, std::span<double> gradient) const noexcept override;
  [[nodiscard]] double lipschitz_bound() const noexcept override { return 1.0; }
  [[nodiscard]] double radius() const noexcept { return radius_; }

 private:
  struct Neighbour {
    double squared_distance;
    Eigen::Index sample;
  };
  NeighbourEstimate() = default;
  // Returns the k-th nearest sample to x, not counting `except`.
  [[nodiscard]] Neighbour Nearest(const double* x, Eigen::Index except) const noexcept;

  core::Matrix samples_;
  int k_ = 1;
  double radius_ = 0.0;
};

/// Fits an estimate to one sample cloud.
using EstimateFitter =
    std::function<std::shared_ptr<const SupportEstimate>(const core::Matrix& samples)>;

/// One estimate of any kind per time step, the counterpart of TimeVaryingSupport.
class EstimatePerStep final : public core::DecisionFunction {
 public:
  /// Demonstrations and `num_steps` as in TimeVaryingSupport::Fit().
  /// @throws std::invalid_argument as TimeVaryingSupport::Fit() does, and everything that `fit`
  ///   throws.
  static EstimatePerStep Fit(std::span<const core::Matrix> demonstrations,
                             const EstimateFitter& fit, int num_steps = 0);

  [[nodiscard]] int state_dim() const noexcept override { return estimates_[0]->state_dim(); }
  [[nodiscard]] int num_steps() const noexcept override {
    return static_cast<int>(estimates_.size());
  }
  [[nodiscard]] double Decision(int t, std::span<const double> x) const noexcept override {
    return at(t).Decision(x);
  }
  double Gradient(int t, std::span<const double> x,
                  std::span<double> gradient) const noexcept override {
    return at(t).Gradient(x, gradient);
  }
  [[nodiscard]] double lipschitz_bound(int t) const noexcept override {
    return at(t).lipschitz_bound();
  }
  [[nodiscard]] const SupportEstimate& at(int t) const noexcept;

 private:
  std::vector<std::shared_ptr<const SupportEstimate>> estimates_;
};

}  // namespace dfr::kernel
