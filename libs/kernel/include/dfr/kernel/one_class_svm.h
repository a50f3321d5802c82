#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>

#include "dfr/core/matrix.h"

namespace dfr::kernel {

/// Argument of OneClassSvmOptions::progress.
struct FitProgress {
  std::int64_t iterations = 0;
  /// Infinity until known. Decreases to the tolerance, not always monotonically.
  double kkt_gap = 0.0;
  double tolerance = 0.0;
};

/// Options for OneClassSvm::Fit(). Defaults are the Pusher values of Sec. V-A.
struct OneClassSvmOptions {
  double nu = 0.05;    ///< Upper bound on the fraction of outliers and lower bound on the fraction
                       ///< of support vectors, in (0, 1]. Values below 1/m have the effect of 1/m.
  double gamma = 5.0;  ///< Width parameter of the Gaussian kernel, > 0, in 1/[state unit]^2.
  /// The fit stops when the largest KKT violation (FitSummary) is below this value.
  double tolerance = 1e-4;
  /// Maximum number of working-set steps; 0 selects a limit beyond any practical problem.
  std::int64_t max_iterations = 0;
  double memory_mib = 512.0;  ///< Limit on the fit's memory, >= 1. Tight limits slow the fit.
  /// Number of threads of this fit, >= 0; 0: one per core. The estimate has the same bits for any
  /// number.
  int threads = 1;
  /// Initial alpha per sample, in any scale, from a neighbouring problem (the previous time step,
  /// gamma or nu; see FitSummary::alpha). Empty: the solver chooses. Changes the estimate only
  /// within the tolerance.
  std::span<const double> start = {};
  /// Weight of each sample, >= 0, as in LIBSVM and scikit-learn: 0 <= alpha_i <= w_i/(nu sum w).
  /// Empty: equal weights. An integer weight k is equivalent to repeating the sample k times.
  /// Weighted fits are slower: their kernel is in double and never cached. They accept no `start`.
  std::span<const double> weights = {};
  /// Progress callback. The fitting thread calls it several times a second or more. Returning false
  /// stops the fit.
  std::function<bool(const FitProgress&)> progress = {};
};

/// Result and cost of a fit.
struct FitSummary {
  enum class Reason {
    kConverged,      ///< kkt_gap is below the tolerance.
    kMaxIterations,  ///< Stopped by max_iterations. The estimate is usable; kkt_gap gives its
                     ///< accuracy.
    /// Stopped by `progress`. kkt_gap is infinity if no gap was computed yet.
    kInterrupted,
    /// No further progress: the tolerance is below the rounding error of doubles for these samples,
    /// or below that of floats while memory_mib is too small for doubles.
    kStalled,
  };
  Reason reason = Reason::kConverged;
  std::int64_t iterations = 0;
  /// max G_i over alpha_i > 0, minus min G_i over alpha_i < 1, with G = K alpha. Here alpha sums to
  /// nu m, which gives tolerances the same meaning as in LIBSVM. The gap is verified: it is
  /// recomputed in double, or it is an upper bound below the tolerance.
  double kkt_gap = 0.0;
  double objective = 0.0;  ///< alpha' K alpha / 2 in LIBSVM's scale.
  int num_support_vectors = 0;
  std::int64_t kernel_evaluations = 0;
  double seconds = 0.0;   ///< Wall time.
  Eigen::VectorXd alpha;  ///< One per sample, summing to 1; can start another fit.
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
/// g > 0 inside the support. alpha sums to 1 as in the paper. LIBSVM's alpha sums to nu m: its g
/// (and any lambda tuned on it) is libsvm_scale() times this g.
/// Immutable after construction. Copies are cheap because they share data. Concurrent calls are
/// safe.
class OneClassSvm {
 public:
  /// Maximum number of entries of a state.
  static constexpr int kMaxStateDim = 2048;

  /// Fits to `samples` (m x n, one state per row).
  /// @throws std::invalid_argument if m < 2, n < 1, n > kMaxStateDim, an entry is not finite or so
  ///   far from the others that squares overflow (1e150 widths), or an option is out of range. The
  ///   message names the problem.
  static OneClassSvm Fit(const Eigen::Ref<const core::Matrix>& samples,
                         const OneClassSvmOptions& options, FitSummary* summary = nullptr);

  /// Builds an estimate from the parts that Fit() computes: one support vector per row, alpha
  /// positive and summing to 1, rho finite. `libsvm_scale` is nu m.
  /// @throws std::invalid_argument naming the invalid part.
  static OneClassSvm FromParts(core::Matrix support_vectors, Eigen::VectorXd alpha, double gamma,
                               double rho, double libsvm_scale = 1.0);

  /// Returns g(x) for one state of size state_dim(). Never allocates, never throws. A non-finite
  /// entry or another size gives -infinity: readings of a broken sensor count as outside.
  [[nodiscard]] double Decision(std::span<const double> x) const noexcept;

  /// Returns g(x) and writes its derivative 2 gamma sum_i alpha_i k(x, x_i) (x_i - x) to `gradient`
  /// (state_dim() entries). The gradient is zero where g is -infinity. Never allocates.
  double Gradient(std::span<const double> x, std::span<double> gradient) const noexcept;

  /// Returns l(x) = log(sum_i alpha_i k(x, x_i)) - log rho. It has the sign and zero set of g but
  /// does not underflow: far outside, it still distinguishes distances. It is -infinity where g is
  /// -infinity or squared distances overflow, and +infinity for rho <= 0. Never allocates.
  [[nodiscard]] double LogDecision(std::span<const double> x) const noexcept;
  /// Converts l to g: rho (e^l - 1). Maps infinities to themselves.
  [[nodiscard]] double FromLog(double l) const noexcept;

  /// Returns l(x) and writes its derivative 2 gamma ms to `gradient`, where ms = sum_i w_i (x_i -
  /// x) and w_i is proportional to alpha_i k(x, x_i). The gradient is zero where l is -infinity.
  /// Never allocates.
  ///
  /// For any samples, Jensen's inequality with these weights gives
  ///   l(x + d) >= l(x) + d . grad l(x) - gamma |d|^2.
  double LogGradient(std::span<const double> x, std::span<double> gradient) const noexcept;

  /// Writes g of each row of `x` (any number x state_dim()), with the same bits as Decision(), on
  /// `threads` threads (0: one per core). With one thread it neither allocates nor locks.
  /// @throws std::invalid_argument if the shapes do not match or threads < 0.
  void DecisionBatch(const Eigen::Ref<const core::Matrix>& x, std::span<double> g,
                     int threads = 1) const;

  /// Returns the same estimate, evaluated in float with twice the vector lanes and half the memory.
  /// The relative error of the kernel sum is at most 1e-6 + 5e-9 n for states of n entries, if no
  /// entry is farther than a few widths 1/sqrt(gamma) from the centre of the support vectors. The
  /// error grows in proportion to that distance.
  [[nodiscard]] OneClassSvm InSinglePrecision() const;

  /// Returns L with |g(x) - g(y)| <= L |x - y|. It is the steepest slope of one kernel, sqrt(2
  /// gamma / e), because alpha sums to 1.
  [[nodiscard]] double lipschitz_bound() const noexcept;

  [[nodiscard]] int state_dim() const noexcept;
  [[nodiscard]] int num_support_vectors() const noexcept;
  /// One support vector per row, in the order of alpha().
  [[nodiscard]] const core::Matrix& support_vectors() const noexcept;
  [[nodiscard]] const Eigen::VectorXd& alpha() const noexcept;
  [[nodiscard]] double gamma() const noexcept;
  [[nodiscard]] double rho() const noexcept;
  /// nu m (nu sum w with weights): multiply alpha, rho and g by it to get LIBSVM's values.
  [[nodiscard]] double libsvm_scale() const noexcept;

 private:
  struct Parts;
  struct Data;
  friend OneClassSvm internal::FitSharing(const core::Matrix& samples,
                                          const OneClassSvmOptions& options,
                                          internal::Scratch& scratch, FitSummary* summary);
  explicit OneClassSvm(std::shared_ptr<const Data> data) noexcept;
  std::shared_ptr<const Data> data_;
};

}  // namespace dfr::kernel
