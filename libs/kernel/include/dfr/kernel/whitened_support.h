#pragma once

#include <span>
#include <vector>

#include "dfr/core/decision_function.h"
#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"

namespace dfr::kernel {

/// Options for WhitenedSupport::Fit(). Defaults suit whitened features (core::FeatureTransform),
/// for which gamma has the same units in all tasks.
struct WhitenedSupportOptions {
  /// One gamma suits all tasks, because features are whitened. docs/recovery.md compares values.
  OneClassSvmOptions svm = {.nu = 0.05, .gamma = 0.25, .tolerance = 1e-6};
  /// The estimate at t uses the states of t - window k, t - (window - 1) k, ..., t + window k.
  int window = 2;
  /// Sets the stride k: 1, or larger if needed for the window to span this fraction of the time
  /// steps on either side. In longer tasks, demonstrations differ more at a given time step. A
  /// larger value pools more states but locates a state in the task less precisely.
  double window_share = 0.02;
  double phase_ridge = 0.3;     ///< Added to each time step's covariance before inversion, > 0.
  bool phase_whitening = true;  ///< If false, V_t is the identity.
  /// If true, each time step uses the covariance of states about their neighbours
  /// (core::LocalScatter()). If a task can be done in several ways, this is the covariance within
  /// one way. If false, it uses the covariance of the states about their mean.
  bool local = true;
  /// Evaluates in float, in about half the time; see OneClassSvm::InSinglePrecision() for the
  /// error. Not for certificates, which need full precision.
  bool single_precision = false;
  /// If true, a demonstration that has ended counts once, with its last state, which keeps the goal
  /// inside.
  bool hold_ended = true;
  /// A time step has an estimate only if at least this fraction of the demonstrations, and at least
  /// two of them, are still running.
  double least_share = 0.1;
  /// Number of time steps from one estimate to the next, >= 1. Time step t of the support is time
  /// step every * t of the demonstrations.
  int every = 1;

  /// Returns the stride k for a support with this many time steps.
  [[nodiscard]] int Stride(int num_steps) const noexcept;
};

/// Support of demonstrated features at each time step, for guided recovery: a tight estimate of
/// their core rather than one that accepts nearly every state.
///
/// Differences from TimeVaryingSupport:
/// - It pools the states of neighbouring time steps. Few demonstrations suffice, and timing matters
///   less.
/// - Each time step has its own linear map y = V_t z, V_t = (Cov_t + phase_ridge I)^(-1/2), because
///   the spread of demonstrations changes along a task. Cov_t is the sum of two covariances of the
///   pooled states: the covariance of the demonstrations' means about neighbouring means, and the
///   covariance of each demonstration's states about their mean.
/// - A demonstration that has ended counts at most once per time step (hold_ended). The last
///   estimates mainly describe the slow demonstrations. Later time steps use the final estimate.
///
/// Immutable after construction. Concurrent calls are safe.
class WhitenedSupport final : public core::LogDecisionFunction {
 public:
  /// Maximum number of features: queries are mapped into a buffer on the stack.
  static constexpr int kMaxFeatures = 256;

  /// Fits to one matrix of features per demonstration, rows in time order. If svm.progress, which
  /// is called at least once per time step, returns false, the support ends with that time step.
  /// @throws std::invalid_argument if there are fewer than two demonstrations, widths differ, an
  ///   entry is not finite or an option is out of range.
  static WhitenedSupport Fit(std::span<const core::Matrix> demonstrations,
                             const WhitenedSupportOptions& options = {});

  /// g_t in its coordinates y = map z.
  struct Estimate {
    core::Matrix map;  ///< state_dim x state_dim
    OneClassSvm svm;
  };
  /// Combines the estimates that Fit() computes, g_0 first.
  /// @throws std::invalid_argument naming the estimate whose sizes do not match or whose map is not
  ///   finite and symmetric.
  explicit WhitenedSupport(std::vector<Estimate> estimates);

  [[nodiscard]] int state_dim() const noexcept override;
  [[nodiscard]] int num_steps() const noexcept override;
  [[nodiscard]] double Decision(int t, std::span<const double> z) const noexcept override;
  double Gradient(int t, std::span<const double> z,
                  std::span<double> gradient) const noexcept override;
  double LogDecision(int t, std::span<const double> z,
                     std::span<double> gradient) const noexcept override;
  [[nodiscard]] double FromLog(int t, double l) const noexcept override;
  /// Returns gamma times the squared spectral norm of V_t (see OneClassSvm::LogGradient()).
  [[nodiscard]] double curvature_bound(int t) const noexcept override;

  /// Returns g_t in the coordinates y = map(t) z; times out of range use the nearest estimate.
  [[nodiscard]] const OneClassSvm& estimate(int t) const noexcept { return at(t).svm; }
  [[nodiscard]] const core::Matrix& map(int t) const noexcept { return at(t).map; }

 private:
  struct Phase {
    core::Matrix map;
    double norm;  ///< Spectral norm of map.
    OneClassSvm svm;
  };
  [[nodiscard]] const Phase& at(int t) const noexcept;

  std::vector<Phase> phases_;
};

/// Result of a test that a support excludes the space between different ways to do a task. The test
/// looks for time steps at which the demonstrated states form clusters (core::SpanningTree(), in
/// the coordinates of that time step). A cluster has at least three states and at least a tenth of
/// all states. It is at least four standard deviations of states about their neighbours away from
/// the next cluster. The midpoint between two neighbouring clusters should be outside, unless a
/// demonstration passes near it at another time. Chance also produces such clusters at a few time
/// steps.
struct ModeSeparationTest {
  int steps = 0;   ///< Number of tested time steps: all steps of the support.
  int points = 0;  ///< Number of midpoints between two clusters, over all time steps.
  int inside = 0;  ///< Number of midpoints inside the support.
};
/// @throws std::invalid_argument if widths differ.
[[nodiscard]] ModeSeparationTest TestModeSeparation(const WhitenedSupport& support,
                                                    std::span<const core::Matrix> demonstrations);

/// Returns the mean over time steps of log(V_narrow / V_wide). V is the volume of {l >= level} of a
/// support of these demonstrations; the two supports differ only in gamma. If the same number of
/// left-out states reaches each level, the smaller volume describes the demonstrations better
/// (Thomas, Feuillard and Gramfort 2015, arXiv:1506.05600). Uses importance sampling with 400 fixed
/// draws per time step. Ignores time steps with fewer than 5 demonstrations or with fewer than 10
/// draws inside `narrow`; returns 0 if no time step remains.
[[nodiscard]] double LogVolumeRatio(const WhitenedSupport& wide, double wide_level,
                                    const WhitenedSupport& narrow, double narrow_level,
                                    std::span<const core::Matrix> demonstrations);

}  // namespace dfr::kernel
