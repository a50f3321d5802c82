#include "dfr/reduction/choose_components.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>

#include "dfr/control/phase_tracker.h"
#include "dfr/control/response/response_estimate.h"
#include "dfr/core/contract.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/core/numerics/folds.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/text/format.h"
#include "dfr/reduction/action_directions.h"

namespace dfr::reduction {
namespace {

constexpr std::size_t kMostActions = 1000;
// Number of scores that determine the similarity of demonstrations.
constexpr Eigen::Index kFoldScores = 8;
constexpr std::size_t kLeastDemonstrations = 4;

// Sums over the scored actions of one demonstration, in units of the root mean square nonzero
// action.
struct Sums {
  explicit Sums(Eigen::Index control_dim) : v(Eigen::VectorXd::Zero(control_dim)) {}
  double inside = 0.0;
  double states = 0.0;
  double guessed = 0.0;  // Number of actions with neighbours for the regression.
  Eigen::VectorXd v;     // Sum of the actions with neighbours.
  double squares = 0.0;  // Sum of the squares of these actions.
  double missed = 0.0;   // Sum of squared errors of the regression.
  double changes = 0.0;  // Sum of squared changes of components.
  double wrong = 0.0;    // Sum of squared errors of predicted changes.
};

ComponentsScore Score(int components, const std::vector<Sums>& each) {
  Sums all(each[0].v.size());
  for (const Sums& one : each) {
    all.inside += one.inside;
    all.states += one.states;
    all.guessed += one.guessed;
    all.v += one.v;
    all.squares += one.squares;
    all.missed += one.missed;
    all.changes += one.changes;
    all.wrong += one.wrong;
  }
  ComponentsScore score{.components = components, .inside = all.inside / all.states};
  if (all.changes > 0.0) score.response_error = all.wrong / all.changes;
  if (!(all.guessed > 0.0)) {
    score.action_error = 1.0;  // No action can be predicted.
    return score;
  }
  if (all.squares > 0.0) score.action_error = all.missed / all.squares;
  const double variance = all.squares - all.v.squaredNorm() / all.guessed;
  // An action that is the same everywhere is predicted perfectly.
  constexpr double kConstant = 1e-9;
  if (variance <= kConstant * all.squares) {
    score.explained = 1.0;
    return score;
  }
  score.explained = 1.0 - all.missed / variance;
  // Linearised standard error of a ratio of sums over demonstrations, from the residuals
  // missed - (1 - explained) * variance.
  double square = 0.0;
  const Eigen::VectorXd mean = all.v / all.guessed;
  for (const Sums& one : each) {
    const double own = one.squares - 2.0 * mean.dot(one.v) + one.guessed * mean.squaredNorm();
    const double residual = one.missed - (1.0 - score.explained) * own;
    square += residual * residual;
  }
  const auto count = static_cast<double>(each.size());
  score.explained_error = std::sqrt(square * count / (count - 1.0)) / variance;
  return score;
}

// Evaluates numbers of components. Holds the data that all evaluations share.
class Judge {
 public:
  // `sizes` lists the number of scores of each block.
  Judge(std::span<const core::Trajectory> demonstrations, const ChooseComponentsOptions& options,
        std::span<const Eigen::Index> sizes)
      : demonstrations_(demonstrations), options_(options), sizes_(sizes) {
    std::vector<core::Matrix> first_scores;
    double square = 0.0;
    double moving = 0.0;
    std::size_t actions = 0;
    for (const core::Trajectory& d : demonstrations) {
      first_scores.push_back(d.states.leftCols(std::min(kFoldScores, d.states.cols())));
      for (Eigen::Index t = 0; t < d.controls.rows(); ++t) {
        const double norm = d.controls.row(t).squaredNorm();
        square += norm;
        moving += norm > 0.0 ? 1.0 : 0.0;
      }
      actions += static_cast<std::size_t>(d.controls.rows());
    }
    DFR_THROW_UNLESS(square > 0.0, "all demonstrated actions are zero");
    unit_ = std::sqrt(square / moving);
    stride_ = std::max<std::size_t>(1, actions / kMostActions);
    order_ = core::DeterministicOrder(demonstrations);
    const int folds =
        std::min(options.folds, std::max(2, static_cast<int>(demonstrations.size() / 2)));
    const auto whitening = core::FeatureTransform::Whitening(
        core::FeatureSelection::All(static_cast<int>(first_scores[0].cols())), first_scores);
    for (core::Matrix& scores : first_scores) scores = whitening.Apply(scores);
    folds_ = core::StratifiedFolds(first_scores, folds);
    for (std::size_t fold = 0; options.by_actions && fold < folds_.size(); ++fold) {
      std::vector<core::Trajectory> others;
      for (const std::size_t d : core::Others(folds_, fold, order_)) {
        others.push_back(demonstrations[d]);
      }
      directions_.emplace_back(others, options.blocks);
    }
  }

  // Returns nothing if a callback of the options stopped it.
  [[nodiscard]] std::optional<ComponentsScore> operator()(int components) const {
    std::vector<Sums> each(demonstrations_.size(), Sums(demonstrations_[0].controls.cols()));
    std::size_t next = 0;
    for (std::size_t fold = 0; fold < folds_.size(); ++fold) {
      if (!JudgeFold(fold, components, each, next)) return std::nullopt;
    }
    return Score(components, each);
  }

 private:
  // Returns the map from scores to the columns that `components` components use.
  [[nodiscard]] core::Matrix Weights(std::size_t fold, int components) const {
    const Eigen::Index all = demonstrations_[0].states.cols();
    if (directions_.empty()) {
      Eigen::Index columns = options_.beside;
      for (const Eigen::Index size : sizes_) columns += std::min<Eigen::Index>(components, size);
      return core::Matrix::Identity(columns, all);
    }
    core::Matrix weights = core::Matrix::Identity(options_.beside, all);
    for (std::size_t block = 0; block < options_.blocks.size(); ++block) {
      const core::Matrix own = directions_[fold].Weights(block, components);
      weights.conservativeResize(weights.rows() + own.rows(), Eigen::NoChange);
      weights.bottomRows(own.rows()).setZero();
      weights.bottomRows(own.rows())(Eigen::all, options_.blocks[block]) = own;
    }
    return weights;
  }

  [[nodiscard]] bool GoingOn() const { return !options_.going_on || options_.going_on(); }

  // Returns false if a callback of the options stopped it.
  [[nodiscard]] bool JudgeFold(std::size_t fold, int components, std::vector<Sums>& each,
                               std::size_t& next) const {
    if (!GoingOn()) return false;
    const core::Matrix weights = Weights(fold, components);
    const auto selected = [&](std::size_t d) {
      return core::Matrix(core::Multiply(demonstrations_[d].states, weights.transpose()));
    };
    const std::vector<std::size_t> others = core::Others(folds_, fold, order_);
    std::vector<core::Matrix> points;
    std::vector<core::Matrix> controls;
    for (const std::size_t d : others) {
      points.push_back(selected(d));
      controls.emplace_back(demonstrations_[d].controls / unit_);
    }
    const auto whitening = core::FeatureTransform::Whitening(
        core::FeatureSelection::All(static_cast<int>(weights.rows())), points);
    for (core::Matrix& z : points) z = whitening.Apply(z);
    bool stopped = false;
    kernel::WhitenedSupportOptions options = options_.support;
    if (options.svm.progress) {
      options.svm.progress = [&](const kernel::FitProgress& progress) {
        stopped = stopped || !options_.support.svm.progress(progress);
        return !stopped;
      };
    }
    const auto support = kernel::WhitenedSupport::Fit(points, options);
    if (stopped || !GoingOn()) return false;
    const control::ResponseEstimate estimate(std::make_shared<const control::TransitionStore>(
        points, controls, control::ResponseOptions{}));
    // This order is independent of the order of recording.
    for (const std::size_t d : order_) {
      if (std::ranges::count(folds_[fold], d) == 0) continue;
      JudgeOne(whitening.Apply(selected(d)), demonstrations_[d].controls, support, estimate,
               each[d], next);
    }
    return true;
  }

  void JudgeOne(const core::Matrix& z, const core::Matrix& controls,
                const kernel::WhitenedSupport& support, const control::ResponseEstimate& estimate,
                Sums& sums, std::size_t& next) const {
    control::PhaseTracker tracker(support);
    control::LocalFit fit = estimate.MakeFit();
    Eigen::VectorXd guess(controls.cols());
    for (Eigen::Index t = 0; t < z.rows(); ++t) {
      sums.states += 1.0;
      sums.inside += tracker.Follow(core::Row(z, t)) >= 0.0 ? 1.0 : 0.0;
      if (t >= controls.rows() || next++ % stride_ != 0) continue;
      const Eigen::VectorXd v = controls.row(t).transpose() / unit_;
      estimate.FitAt(tracker.phase(), core::Row(z, t), fit);
      Eigen::VectorXd predicted = z.row(t);
      fit.AddEffect(v, predicted);
      sums.changes += (z.row(t + 1) - z.row(t)).squaredNorm();
      sums.wrong += (z.row(t + 1).transpose() - predicted).squaredNorm();
      guess.setZero();
      if (!fit.NominalControl(guess)) continue;
      sums.guessed += 1.0;
      sums.v += v;
      sums.squares += v.squaredNorm();
      sums.missed += (guess - v).squaredNorm();
    }
  }

  std::span<const core::Trajectory> demonstrations_;
  const ChooseComponentsOptions& options_;
  std::span<const Eigen::Index> sizes_;
  double unit_ = 1.0;
  std::size_t stride_ = 1;
  std::vector<std::size_t> order_;
  core::Folds folds_;
  std::vector<ActionDirections> directions_;  // One per fold; none without by_actions.
};

void Check(std::span<const core::Trajectory> demonstrations,
           const ChooseComponentsOptions& options) {
  DFR_THROW_UNLESS(demonstrations.size() >= kLeastDemonstrations,
                   "choosing the number of components needs at least "
                       << kLeastDemonstrations << " demonstrations; there are "
                       << demonstrations.size());
  const Eigen::Index p = demonstrations[0].states.cols();
  const Eigen::Index m = demonstrations[0].controls.cols();
  DFR_THROW_UNLESS(p >= 1 && m >= 1, "demonstrations need scores and actions");
  for (std::size_t i = 0; i < demonstrations.size(); ++i) {
    const core::Trajectory& d = demonstrations[i];
    DFR_THROW_UNLESS(d.states.cols() == p && d.controls.cols() == m && d.controls.rows() >= 1 &&
                         d.states.rows() == d.controls.rows() + 1,
                     "demonstration " << i << " has " << d.states.rows() << " x " << d.states.cols()
                                      << " scores and " << d.controls.rows() << " x "
                                      << d.controls.cols() << " actions");
    DFR_THROW_UNLESS(d.states.allFinite() && d.controls.allFinite(),
                     "demonstration " << i << " has a non-finite entry");
  }
  DFR_THROW_UNLESS(options.folds >= 2, "folds must be at least 2, not " << options.folds);
  DFR_THROW_UNLESS(!options.candidates.empty() && options.candidates.front() >= 1 &&
                       std::ranges::is_sorted(options.candidates, std::ranges::less_equal{}),
                   "candidates must be positive and ascending");
  DFR_THROW_UNLESS(options.beside >= 0, "beside must not be negative, not " << options.beside);
  DFR_THROW_UNLESS(options.least_inside >= 0.0 && options.least_inside <= 1.0,
                   "least_inside must lie in [0, 1], not " << options.least_inside);
}

void Decide(const ChooseComponentsOptions& options, ComponentsChoice& choice) {
  const ComponentsScore* best = nullptr;
  const ComponentsScore* most_inside = &choice.table[0];
  for (const ComponentsScore& row : choice.table) {
    if (row.inside > most_inside->inside) most_inside = &row;
    if (row.inside < options.least_inside) continue;
    if (best == nullptr || row.explained > best->explained) best = &row;
  }
  if (best == nullptr) {
    choice.reason = core::Format(
        "no number of components keeps %.0f %% of the states of left-out demonstrations inside: at "
        "most %.0f %%, with %d components. Record more demonstrations",
        100.0 * options.least_inside, 100.0 * most_inside->inside, most_inside->components);
    return;
  }
  if (control::LocalFit::Guesses(best->explained, best->action_error)) {
    choice.reason = core::Format(
        "the components do not explain the actions of left-out demonstrations: at most %.0f %% of "
        "their variance, with %d components. Add the other information that the "
        "demonstrator had, such as a second camera or the joints, or record more demonstrations",
        100.0 * std::max(0.0, best->explained), best->components);
    return;
  }
  const double enough = best->explained - best->explained_error;
  for (const ComponentsScore& row : choice.table) {
    if (row.inside < options.least_inside || row.explained < enough) continue;
    choice.components = row.components;
    choice.reason = core::Format(
        "%d components explain %.0f %% of the variance of left-out actions, within one standard "
        "error (%.1f %%) of the best (%.0f %%, with %d), and keep %.0f %% of left-out states "
        "inside",
        row.components, 100.0 * row.explained, 100.0 * best->explained_error,
        100.0 * best->explained, best->components, 100.0 * row.inside);
    return;
  }
}

}  // namespace

ComponentsChoice ChooseComponents(std::span<const core::Trajectory> demonstrations,
                                  const ChooseComponentsOptions& options) {
  Check(demonstrations, options);
  std::vector<Eigen::Index> sizes;
  for (const std::vector<int>& block : options.blocks) sizes.push_back(std::ssize(block));
  if (sizes.empty()) sizes.push_back(demonstrations[0].states.cols() - options.beside);
  const Eigen::Index most = std::ranges::max(sizes);
  DFR_THROW_UNLESS(options.candidates.front() <= most,
                   "the smallest candidate is " << options.candidates.front() << ", but there are "
                                                << most << " scores");
  const Judge judge(demonstrations, options, sizes);
  ComponentsChoice choice;
  for (const int components : options.candidates) {
    if (components > most) continue;
    const std::optional<ComponentsScore> score = judge(components);
    choice.stopped = !score;
    if (choice.stopped) return choice;
    choice.table.push_back(*score);
  }
  Decide(options, choice);
  return choice;
}

}  // namespace dfr::reduction
