#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>

#include "dfr/core/matrix.h"

namespace dfr::kernel {

/// What OneClassSvmOptions::progress is told.
struct FitProgress {
  std::int64_t iterations = 0;
  double kkt_gap = 0.0;  ///< Falls to the tolerance, not always monotonically.
  double tolerance = 0.0;
};

/// Options for OneClassSvm::Fit(). Defaults are the Pusher values of Sec. V-A.
struct OneClassSvmOptions {
  double nu = 0.05;         ///< Outlier bound and support-vector floor, in (0, 1].
  double gamma = 5.0;       ///< Gaussian width, > 0, in 1/[state unit]^2.
  double tolerance = 1e-4;  ///< Stop once the largest KKT violation is below this (FitSummary).
  /// Most working-set steps; 0 chooses a number that no sensible problem reaches.
  std::int64_t max_iterations = 0;
  double memory_mib = 512.0;  ///< Bound on the fit's own memory, >= 1. Slower where it is tight.
  /// Threads of this fit, >= 0; 0: one per core. The estimate has the same bits with any number.
  int threads = 1;
  /// Where to start: alpha per sample, in any scale, from a neighbouring problem (the previous time
  /// step, gamma or nu; FitSummary::alpha holds it). Empty: the solver finds a start. The estimate
  /// is the same within the tolerance.
  std::span<const double> start = {};
  /// How much each sample counts, >= 0, as LIBSVM and scikit-learn take it: 0 <= alpha_i <=
  /// w_i/(nu sum w). Empty: all the same. An integer weight k is equivalent to repeating the
  /// sample k times. Weighted fits are slower, because their kernel is always computed in double
  /// and never cached. Excludes `start`.
  std::span<const double> weights = {};
  /// Called several times a second or more from the thread that fits; false stops the fit.
  std::function<bool(const FitProgress&)> progress = {};
};

/// How a fit ended and what it cost.
struct FitSummary {
  enum class Reason {
    kConverged,      ///< kkt_gap is below the tolerance.
    kMaxIterations,  ///< Stopped by max_iterations: the estimate is usable, kkt_gap says how well.
    /// Stopped by `progress`: as above, if kkt_gap is finite. Infinity: before any could be known.
    kInterrupted,
    /// Rounding allows no better: the tolerance is below what doubles can do for these samples.
    kStalled,
  };
  Reason reason = Reason::kConverged;
  std::int64_t iterations = 0;
  /// max G_i over alpha_i > 0, minus min G_i over alpha_i < 1, with G = K alpha. Like LIBSVM's it
  /// is taken with alpha scaled to sum to nu m, so tolerances mean the same in both. Verified: it
  /// is not the solver's own, but summed in double, or an upper bound where that is below the
  /// tolerance.
  double kkt_gap = 0.0;
  double objective = 0.0;  ///< alpha' K alpha / 2 in LIBSVM's scale.
  int num_support_vectors = 0;
  std::int64_t kernel_evaluations = 0;
  double seconds = 0.0;   ///< Wall time.
  Eigen::VectorXd alpha;  ///< One per sample, in the paper's scale: a start for a neighbour.
};

class OneClassSvm;
namespace internal {
class Scratch;
OneClassSvm FitSharing(const core::Matrix& samples, const OneClassSvmOptions& options,
                       Scratch& scratch, FitSummary* summary);
}  // namespace internal

/// Support estimate of a sample cloud (Sec. IV-A):
///   g(x) = sum_i alpha_i exp(-gamma |x - x_i|^2) - rho,  0 <= alpha_i <= 1/(nu m).
///
/// g > 0 inside the support. alpha sums to 1 as in the paper; LIBSVM's alpha sums to nu m, so its g
/// (and any lambda tuned on it) is libsvm_scale() times ours.
/// Immutable once made, and cheap to copy: copies share their data. Concurrent calls are safe.
class OneClassSvm {
 public:
  /// Most entries of a state.
  static constexpr int kMaxStateDim = 2048;

  /// Fits to `samples` (m x n, one state per row).
  /// @throws std::invalid_argument if m < 2, n < 1, n > kMaxStateDim, an entry is not finite or so
  ///   far from the others that squares overflow (1e150 widths), or an option is out of range; the
  ///   message names which.
  static OneClassSvm Fit(const Eigen::Ref<const core::Matrix>& samples,
                         const OneClassSvmOptions& options, FitSummary* summary = nullptr);

  /// An estimate from its parts, as Fit() would have made it: one support vector per row, alpha
  /// positive and summing to 1, rho finite. `libsvm_scale` is nu m.
  /// @throws std::invalid_argument naming what is wrong.
  static OneClassSvm FromParts(core::Matrix support_vectors, Eigen::VectorXd alpha, double gamma,
                               double rho, double libsvm_scale = 1.0);

  /// g(x) for one state of size state_dim(). Never allocates, never throws. A non-finite entry or
  /// another size returns -infinity, so a broken sensor reads as outside the support.
  [[nodiscard]] double Decision(std::span<const double> x) const noexcept;

  /// g(x), with its derivative 2 gamma sum_i alpha_i k(x, x_i) (x_i - x) written to `gradient`
  /// (state_dim() entries). Where g is -infinity the gradient is zero. Never allocates.
  double Gradient(std::span<const double> x, std::span<double> gradient) const noexcept;

  /// l(x) = log(sum_i alpha_i k(x, x_i)) - log rho: the sign and zero set of g, without its
  /// underflow, so that it tells near from far outside. -infinity where g is, +infinity for
  /// rho <= 0. Never allocates.
  [[nodiscard]] double LogDecision(std::span<const double> x) const noexcept;
  /// g of a state at which l is `l`: rho (e^l - 1); -infinity at -infinity, as Decision() is.
  [[nodiscard]] double FromLog(double l) const noexcept;

  /// l(x), with its derivative 2 gamma ms written to `gradient`, where ms = sum_i w_i (x_i - x) and
  /// w_i is proportional to alpha_i k(x, x_i). Zero where l is -infinity. Never allocates.
  ///
  /// Whatever the samples, Jensen's inequality with these weights gives
  ///   l(x + d) >= l(x) + d . grad l(x) - gamma |d|^2.
  double LogGradient(std::span<const double> x, std::span<double> gradient) const noexcept;

  /// g of each row of `x` (any number x state_dim()), the same bits as Decision() gives, on this
  /// many threads (0: one per core). With one thread it neither allocates nor locks.
  /// @throws std::invalid_argument if the shapes do not fit or threads < 0.
  void DecisionBatch(const Eigen::Ref<const core::Matrix>& x, std::span<double> g,
                     int threads = 1) const;

  /// The same estimate evaluated in float, with twice the lanes and half the memory. The kernel sum
  /// is then within 1e-6 + 5e-9 n of its value, relative, for states of n entries none of which is
  /// beyond a few times the width 1/sqrt(gamma) of the support vectors' middle; the error grows in
  /// proportion to that distance.
  [[nodiscard]] OneClassSvm InSinglePrecision() const;

  /// L with |g(x) - g(y)| <= L |x - y|: the steepest slope of one kernel, sqrt(2 gamma / e), since
  /// alpha sums to 1.
  [[nodiscard]] double lipschitz_bound() const noexcept;

  [[nodiscard]] int state_dim() const noexcept;
  [[nodiscard]] int num_support_vectors() const noexcept;
  /// One support vector per row, in the order of alpha().
  [[nodiscard]] const core::Matrix& support_vectors() const noexcept;
  [[nodiscard]] const Eigen::VectorXd& alpha() const noexcept;
  [[nodiscard]] double gamma() const noexcept;
  [[nodiscard]] double rho() const noexcept;
  /// nu m (with weights nu sum w): what alpha, rho and g are to be multiplied by for LIBSVM's.
  [[nodiscard]] double libsvm_scale() const noexcept;

 private:
  struct Data;
  friend OneClassSvm internal::FitSharing(const core::Matrix& samples,
                                          const OneClassSvmOptions& options,
                                          internal::Scratch& scratch, FitSummary* summary);
  explicit OneClassSvm(std::shared_ptr<const Data> data) noexcept;
  std::shared_ptr<const Data> data_;
};

}  // namespace dfr::kernel
