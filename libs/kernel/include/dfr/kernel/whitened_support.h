#pragma once

#include <span>
#include <vector>

#include "dfr/core/decision_function.h"
#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"

namespace dfr::kernel {

/// Options for WhitenedSupport::Fit(). Defaults suit features that are whitened already
/// (core::FeatureTransform): gamma is then in units that all tasks share.
struct WhitenedSupportOptions {
  /// One gamma for all tasks, whose features are whitened; docs/recovery.md tells what others do.
  OneClassSvmOptions svm = {.nu = 0.05, .gamma = 0.25, .tolerance = 1e-6};
  /// The estimate at t sees the states of t - window k, t - (window - 1) k, ..., t + window k,
  int window = 2;
  /// k = 1, or such that they reach this share of the time steps to either side where that is more:
  /// the longer a task, the further apart demonstrations are at a time step. More has more of them
  /// inside, and knows less of where a state belongs.
  double window_share = 0.02;
  double phase_ridge = 0.3;  ///< Added to each time step's covariance before it is inverted, > 0.
  bool phase_whitening = true;
  /// Each time step's covariance is that of states about their neighbours (core::LocalScatter()):
  /// where there are several ways, that of one. Off: about their mean.
  bool local = true;
  /// Evaluates in float, in about half the time; OneClassSvm::InSinglePrecision() says how near.
  /// Not for certificates, which are to hold to the last digit.
  bool single_precision = false;
  /// A demonstration that has ended counts, once, with its last state: the goal stays inside.
  bool hold_ended = true;
  /// There are estimates for the time steps that at least this share of the demonstrations, and two
  /// of them, are still under way at.
  double least_share = 0.1;

  /// k of a support with so many time steps.
  [[nodiscard]] int Stride(int num_steps) const noexcept;
};

/// The support of demonstrated features at each time step, as guided recovery wants it: a tight
/// core of what was demonstrated rather than an estimate that accepts nearly everything.
///
/// Against TimeVaryingSupport: states of neighbouring time steps are pooled, so that few
/// demonstrations suffice and timing matters less; each time step has its own linear map
/// y = V_t z, V_t = (Cov_t + phase_ridge I)^(-1/2), Cov_t how the demonstrations' means over the
/// pooled states differ from their neighbours' plus how each moves about its mean, because the
/// spread of demonstrations changes along a task; and demonstrations that have ended count no more,
/// so the last estimates are of the slow ones and the very last holds from then on.
///
/// Immutable once made. Concurrent calls are safe.
class WhitenedSupport final : public core::LogDecisionFunction {
 public:
  /// Most features: queries are mapped into a buffer on the stack.
  static constexpr int kMaxFeatures = 256;

  /// Fits to one matrix of features a demonstration, rows in order of time.
  /// @throws std::invalid_argument if there are fewer than two demonstrations, widths differ, an
  ///   entry is not finite or an option is out of range.
  static WhitenedSupport Fit(std::span<const core::Matrix> demonstrations,
                             const WhitenedSupportOptions& options = {});

  /// g_t in coordinates of its own: y = map z.
  struct Estimate {
    core::Matrix map;  ///< state_dim x state_dim
    OneClassSvm svm;
  };
  /// Puts estimates together, g_0 first, as Fit() would have made them.
  /// @throws std::invalid_argument naming the one whose sizes do not fit or whose map is not
  /// finite.
  explicit WhitenedSupport(std::vector<Estimate> estimates);

  [[nodiscard]] int state_dim() const noexcept override;
  [[nodiscard]] int num_steps() const noexcept override;
  [[nodiscard]] double Decision(int t, std::span<const double> z) const noexcept override;
  double Gradient(int t, std::span<const double> z,
                  std::span<double> gradient) const noexcept override;
  /// OneClassSvm::lipschitz_bound() times the spectral norm of V_t.
  [[nodiscard]] double lipschitz_bound(int t) const noexcept override;
  double LogDecision(int t, std::span<const double> z,
                     std::span<double> gradient) const noexcept override;
  [[nodiscard]] double FromLog(int t, double l) const noexcept override;
  /// gamma times the squared spectral norm of V_t (OneClassSvm::LogGradient()).
  [[nodiscard]] double curvature_bound(int t) const noexcept override;

  /// g_t in the coordinates y = map(t) z; times out of range use the nearest one.
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

/// What a support makes of the room between ways. Where the demonstrated states of a time step fall
/// into clusters of a tenth of them and at least three (core::SpanningTree(), in the coordinates of
/// that time step), four standard deviations of states about their neighbours apart and more, the
/// middle between two neighbouring clusters should be outside, unless a demonstration passes near
/// it at another time. Chance makes such clusters, too, at a few time steps.
struct GapTest {
  int steps = 0;   ///< Time steps.
  int points = 0;  ///< Middles between two clusters, at all of them.
  int inside = 0;  ///< Those that the support takes for demonstrated.
};
/// @throws std::invalid_argument if widths differ.
[[nodiscard]] GapTest TestGaps(const WhitenedSupport& support,
                               std::span<const core::Matrix> demonstrations);

/// How deep inside demonstrations are that a support has not seen: l_t of each state of each
/// demonstration under an estimate fitted without it, the largest over the time steps t -
/// phase_window ... t + phase_window, as a controller that re-aligns its phase finds it. Whole
/// demonstrations are left out, because the states of one are alike, in core::StratifiedFolds():
/// the order in which they come changes no bit. Values come in no particular order.
/// @throws as WhitenedSupport::Fit(), and std::invalid_argument if there are fewer than three
///   demonstrations, fewer than two folds, or phase_window is negative.
[[nodiscard]] std::vector<double> HeldOutLevels(std::span<const core::Matrix> demonstrations,
                                                const WhitenedSupportOptions& options = {},
                                                int folds = 5, int phase_window = 3);

}  // namespace dfr::kernel
