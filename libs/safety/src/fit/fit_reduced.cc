#include <algorithm>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/control/response/response_estimate.h"
#include "dfr/core/text/format.h"
#include "dfr/reduction/action_directions.h"
#include "dfr/reduction/choose_components.h"
#include "dfr/safety/constants.h"
#include "dfr/safety/guard_model.h"

namespace dfr::safety {
namespace {

using reduction::ComponentsScore;
using reduction::StateReduction;

std::vector<core::Trajectory> Reduced(const StateReduction& reduction,
                                      std::span<const core::Trajectory> demonstrations) {
  std::vector<core::Trajectory> reduced;
  reduced.reserve(demonstrations.size());
  StateReduction::Workspace workspace(reduction);
  for (const core::Trajectory& demonstration : demonstrations) {
    core::Matrix states(demonstration.states.rows(), reduction.reduced_dim());
    for (Eigen::Index t = 0; t < states.rows(); ++t) {
      if (!reduction.Apply(core::Row(demonstration.states, t), workspace)) {
        throw std::invalid_argument(
            core::Format("demonstration %td, state %td: ", std::ssize(reduced),
                         static_cast<std::ptrdiff_t>(t)) +
            reduction.Fault(core::Row(demonstration.states, t)));
      }
      states.row(t) = core::AsVector(workspace.state()).transpose();
    }
    core::Trajectory one;
    one.states = std::move(states);
    one.controls = demonstration.controls;
    one.outcome = demonstration.outcome;
    one.seed = demonstration.seed;
    reduced.push_back(std::move(one));
  }
  return reduced;
}

// Returns the scores of all components of each state, in order of components.
std::vector<core::Trajectory> Scores(const StateReduction& all,
                                     std::span<const core::Trajectory> demonstrations) {
  std::vector<core::Trajectory> scores = Reduced(all, demonstrations);
  const std::vector<int> columns = all.InOrderOfComponents();
  for (core::Trajectory& d : scores) d.states = core::Matrix(d.states(Eigen::all, columns));
  return scores;
}

// Components among which the fit chooses: the first ones, or directions that actions depend on.
struct Pool {
  StateReduction reduction;
  bool by_actions = false;
  std::vector<core::Trajectory> scores = {};
  reduction::ComponentsChoice choice = {};
};

// Scores each number of components on left-out demonstrations.
void Judge(std::span<const core::Trajectory> demonstrations, const GuardOptions& options,
           Pool& pool) {
  const StateReduction& all = pool.reduction;
  pool.scores = Scores(all, demonstrations);
  reduction::ChooseComponentsOptions choose;
  choose.folds = options.folds;
  choose.support = options.support;
  if (options.progress) {
    choose.going_on = [&] { return options.progress("choosing components", 0.0); };
  }
  choose.least_inside = 0.0;  // Suffices() checks the guard with each number of components.
  choose.blocks = all.PositionsInOrder();
  choose.by_actions = pool.by_actions;
  choose.beside = all.WithComponents(1).reduced_dim() - all.num_open();
  const int most = pool.by_actions ? std::min(fit::kMostByActions, all.most_components())
                                   : all.most_components();
  std::erase_if(choose.candidates, [&](int k) { return k > most; });
  if (choose.candidates.empty()) choose.candidates = {most};
  pool.choice = reduction::ChooseComponents(pool.scores, choose);
}

class Components {
 public:
  Components(const StateReduction& all, std::span<const core::Trajectory> demonstrations,
             const GuardOptions& options) {
    pools_.push_back({all});
    // Sums of pixels chosen by actions overfit, and attribution spreads them over the picture.
    if (!all.sums_open_pixels()) {
      pools_.push_back({all.WithComponents(fit::kMostByActions), true});
      if (all.most_components() > fit::kMostByActions) pools_.push_back({all, true});
    }
    for (Pool& pool : pools_) {
      Judge(demonstrations, options, pool);
      stopped_ = pool.choice.stopped;
      if (stopped_) return;
    }
    if (!options.accept_any &&
        std::ranges::all_of(pools_, [](const Pool& pool) { return pool.choice.components == 0; })) {
      throw std::invalid_argument(options.features + ": " + pools_[0].choice.reason);
    }
  }

  // Returns true if a callback stopped the choice: it has no candidates.
  [[nodiscard]] bool stopped() const noexcept { return stopped_; }

  struct Candidate {
    const Pool* pool = nullptr;
    int components = 0;
  };
  // Returns the candidates within one standard error of the best: the first components, then the
  // components by actions, each with the smallest number first.
  [[nodiscard]] std::vector<Candidate> Candidates() const {
    const ComponentsScore& best = Best();
    std::vector<Candidate> candidates;
    for (const Pool& pool : pools_) {
      for (const ComponentsScore& row : pool.choice.table) {
        if (row.explained >= best.explained - best.explained_error) {
          candidates.push_back({&pool, row.components});
        }
      }
    }
    std::ranges::stable_sort(candidates, {}, [](const Candidate& candidate) {
      return std::pair(candidate.pool->by_actions, candidate.components);
    });
    return candidates;
  }

  [[nodiscard]] static StateReduction Reduction(const Candidate& candidate) {
    const StateReduction& all = candidate.pool->reduction;
    if (!candidate.pool->by_actions) return all.WithComponents(candidate.components);
    const std::vector<std::vector<int>> blocks = all.PositionsInOrder();
    const reduction::ActionDirections directions(candidate.pool->scores, blocks);
    std::vector<core::Matrix> weights;
    for (std::size_t i = 0; i < blocks.size(); ++i) {
      weights.push_back(directions.Weights(i, candidate.components));
    }
    return all.Combined(weights);
  }

  // Writes the scores of the candidates, and the reason for the choice of `candidate`.
  void Describe(const Candidate& candidate, GuardSummary& summary) const {
    summary.components = candidate.pool->choice.table;
    const bool by_actions = candidate.pool->by_actions;
    const auto row =
        std::ranges::find(summary.components, candidate.components, &ComponentsScore::components);
    // The final directions are fitted to all actions. The table's scores leave some actions out.
    if (by_actions) summary.explained = std::min(summary.explained, row->explained);
    const ComponentsScore& best = Best();
    summary.components_reason = core::Format(
        "%d components%s explain %.0f %% of the variance of left-out actions, within one standard "
        "error (%.1f %%) of the best (%.0f %%, with %d); the guard on them keeps %.0f %% of "
        "left-out states inside and would change %.0f %% of left-out actions",
        candidate.components, by_actions ? " that actions depend on" : "", 100.0 * row->explained,
        100.0 * best.explained_error, 100.0 * best.explained, best.components,
        100.0 * summary.acceptance, 100.0 * summary.changed);
  }

 private:
  [[nodiscard]] const ComponentsScore& Best() const {
    const ComponentsScore* best = &pools_[0].choice.table[0];
    for (const Pool& pool : pools_) {
      for (const ComponentsScore& row : pool.choice.table) {
        if (row.explained > best->explained) best = &row;
      }
    }
    return *best;
  }

  std::vector<Pool> pools_;
  bool stopped_ = false;
};

bool Suffices(const GuardSummary& summary) {
  return summary.acceptance >= fit::kLeastInsideReduced &&
         summary.below_pass <= fit::kMostBelowPassReduced;
}

}  // namespace

std::shared_ptr<GuardModel> GuardModel::FitReduced(const core::StateLayout& layout,
                                                   std::span<const core::Trajectory> demonstrations,
                                                   const GuardOptions& options) {
  const StateReduction all = StateReduction::Fit(layout, options.features, demonstrations);
  std::optional<const Components> open;
  std::vector<Components::Candidate> candidates(1);
  if (all.num_open() > 0) {
    if (open.emplace(all, demonstrations, options).stopped()) return nullptr;
    candidates = open->Candidates();
  }
  std::shared_ptr<GuardModel> best;
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    const auto reduction =
        std::make_shared<const StateReduction>(open ? Components::Reduction(candidates[i]) : all);
    GuardOptions own = options;
    own.features = reduction->features();
    own.accept_any = true;  // Suffices() checks the result.
    const int features =
        core::FeatureSelection(reduction->reduced_layout(), own.features).num_features();
    own.support.svm.gamma *= std::min(1.0, fit::kFeaturesOfGamma / features);
    if (options.progress) {
      own.progress = [&](std::string_view stage, double share) {
        return options.progress(
            stage, (static_cast<double>(i) + share) / static_cast<double>(candidates.size()));
      };
    }
    std::shared_ptr<GuardModel> model =
        FitStates(reduction->reduced_layout(), Reduced(*reduction, demonstrations), own, false);
    if (!model) return nullptr;
    model->reduction_ = reduction;
    if (open) open->Describe(candidates[i], model->summary_);
    const bool good = Suffices(model->summary_);
    if (good || !best || model->summary_.below_pass < best->summary_.below_pass) {
      best = std::move(model);
    }
    if (good) break;
  }
  const GuardSummary& summary = best->summary_;
  if (options.accept_any || Suffices(summary)) {
    best->DoubtCorrections(/*watch=*/!options.accept_any);
    return best;
  }
  throw std::invalid_argument(
      options.features +
      core::Format(
          ": with %d features %.0f %% of the states of left-out demonstrations are inside, and "
          "%.0f %% of their actions end at too low a level to pass. At least %.0f %% must be "
          "inside, and at most %.0f %% may end there; otherwise the guard would stop even the "
          "demonstrator. "
          "Record more demonstrations, choose features with fewer irrelevant details (points: of "
          "a picture, grey, a smaller size, light=standard), or add states to the features%s. To "
          "fit anyway, use --accept-any or accept_any=True",
          best->task().features().selection().num_features(), 100.0 * summary.acceptance,
          100.0 * summary.below_pass, 100.0 * fit::kLeastInsideReduced,
          100.0 * fit::kMostBelowPassReduced,
          open ? "" : ", or let the fit choose the number of components"));
}

void GuardModel::DoubtCorrections(bool watch) {
  const Strategy strategy = settings_.strategy;
  if (strategy != Strategy::kGuard && strategy != Strategy::kController) return;
  const std::string& features = task().features().selection().spec();
  std::string warning = core::Format("%s explain %.0f %% of the actions of left-out demonstrations",
                                     features.c_str(), 100.0 * summary_.explained);
  // An entry that barely varies, such as a speed, can hide a poor prediction of another entry in
  // action_error.
  const bool blind =
      (summary_.explained < fit::kLeastTold && summary_.entry_error > 1.0 - fit::kLeastTold) ||
      control::LocalFit::Guesses(summary_.explained, summary_.action_error);
  if (!blind && summary_.ends_outside <= fit::kMostOutsideReduced) {
    if (summary_.explained >= fit::kLeastExplainedReduced) return;
    warning += core::Format(
        ". Unless actions are noisy, corrections save few failures below %.0f %%: add states to "
        "the pictures, or record more demonstrations",
        100.0 * fit::kLeastExplainedReduced);
    summary_.fit_warnings.push_back(std::move(warning));
    return;
  }
  if (blind) {
    warning += core::Format("; corrections need at least %.0f %%: ", 100.0 * fit::kLeastTold);
  } else {
    warning += core::Format(
        ", and %.0f %% of these are predicted to end outside; corrections need at most %.0f %%: ",
        100.0 * summary_.ends_outside, 100.0 * fit::kMostOutsideReduced);
  }
  if (watch) {
    warning +=
        core::Format("the guard only raises alarms (strategy monitor, not %s). ", Name(strategy));
    settings_.strategy = Strategy::kMonitor;
  } else {
    warning += "its corrections can make a good policy fail. ";
  }
  warning += "Use points: of pictures, add states to them, or set the strategy after test runs";
  summary_.fit_warnings.push_back(std::move(warning));
}

}  // namespace dfr::safety
