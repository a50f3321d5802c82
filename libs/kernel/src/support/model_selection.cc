#include "dfr/kernel/model_selection.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "dfr/core/contract.h"
#include "dfr/core/numerics/log_gamma.h"
#include "dfr/core/random.h"
#include "dfr/core/text/format.h"
#include "dfr/core/workers.h"
#include "support/fit_sharing.h"

namespace dfr::kernel {
namespace {

void CheckOptions(const SelectionOptions& options, std::size_t demonstrations) {
  DFR_THROW_UNLESS(!options.gammas.empty(), "gammas is empty: give at least one to choose from");
  DFR_THROW_UNLESS(!options.nus.empty(), "nus is empty: give at least one to choose from");
  DFR_THROW_UNLESS(options.folds >= 2, "folds must be at least 2, not " << options.folds);
  DFR_THROW_UNLESS(options.acceptance > 0.0 && options.acceptance <= 1.0,
                   "acceptance must lie in (0, 1], not " << options.acceptance);
  DFR_THROW_UNLESS(options.false_alarms > 0.0 && options.false_alarms < 1.0,
                   "false_alarms must lie in (0, 1), not " << options.false_alarms);
  DFR_THROW_UNLESS(demonstrations >= 2 * static_cast<std::size_t>(options.folds),
                   options.folds << " folds need at least " << 2 * options.folds
                                 << " demonstrations; there are " << demonstrations);
}

// Returns the fold of each demonstration.
std::vector<int> AssignFolds(std::size_t demonstrations, const SelectionOptions& options) {
  std::vector<int> fold(demonstrations);
  for (std::size_t i = 0; i < fold.size(); ++i) {
    fold[i] = static_cast<int>(i) % options.folds;
  }
  core::Random random(options.seed);
  random.Shuffle(std::span(fold));
  return fold;
}

// Returns states sampled uniformly from the bounding box of the demonstrations.
core::Matrix DrawFromBox(std::span<const core::Matrix> demonstrations, std::uint64_t seed) {
  constexpr int kDraws = 2000;
  Eigen::RowVectorXd low = demonstrations[0].colwise().minCoeff();
  Eigen::RowVectorXd high = demonstrations[0].colwise().maxCoeff();
  for (const core::Matrix& states : demonstrations) {
    low = low.cwiseMin(states.colwise().minCoeff());
    high = high.cwiseMax(states.colwise().maxCoeff());
  }
  core::Random random(core::DeriveSeed(seed, {1}));
  core::Matrix draws(kDraws, low.size());
  for (Eigen::Index i = 0; i < kDraws; ++i) {
    for (Eigen::Index k = 0; k < low.size(); ++k) draws(i, k) = random.Uniform(low[k], high[k]);
  }
  return draws;
}

// Counts for one SelectionRow, in one fold or over all folds.
struct Tally {
  std::int64_t states = 0;
  std::int64_t inside = 0;
  std::int64_t steps = 0;
  std::int64_t drawn_inside = 0;
  std::int64_t support_vectors = 0;
  int never_left = 0;
  std::vector<double> scores;

  void Add(const TimeVaryingSupport& support, std::span<const core::Matrix* const> held_out,
           const core::Matrix& draws) {
    for (int t = 0; t < support.num_steps(); ++t) {
      support_vectors += support.at(t).num_support_vectors();
    }
    for (Eigen::Index i = 0; i < draws.rows(); ++i) {
      const int t = static_cast<int>(i) % support.num_steps();
      drawn_inside += support.Decision(t, core::Row(draws, i)) >= 0.0 ? 1 : 0;
    }
    steps += support.num_steps();
    for (const core::Matrix* held : held_out) {
      for (Eigen::Index t = 0; t < held->rows(); ++t) {
        inside += support.Decision(static_cast<int>(t), core::Row(*held, t)) >= 0.0 ? 1 : 0;
      }
      states += held->rows();
      scores.push_back(ExcursionScore(support, *held));
      never_left += scores.back() <= 0.0 ? 1 : 0;
    }
  }

  void Add(const Tally& other) {
    states += other.states;
    inside += other.inside;
    steps += other.steps;
    drawn_inside += other.drawn_inside;
    support_vectors += other.support_vectors;
    never_left += other.never_left;
    scores.insert(scores.end(), other.scores.begin(), other.scores.end());
  }

  [[nodiscard]] SelectionRow Row(internal::NuGamma pair, const SelectionOptions& options,
                                 Eigen::Index draws) const {
    SelectionRow row;
    row.nu = pair.nu;
    row.gamma = pair.gamma;
    row.acceptance = static_cast<double>(inside) / static_cast<double>(states);
    row.inside_throughout = static_cast<double>(never_left) / static_cast<double>(scores.size());
    row.support_vectors = static_cast<double>(support_vectors) / static_cast<double>(steps);
    row.volume = static_cast<double>(drawn_inside) / static_cast<double>(options.folds * draws);
    row.threshold = ConformalThreshold(scores, options.false_alarms);
    return row;
  }
};

// Returns the smallest k with P(Beta(k, n + 1 - k) >= 1 - alpha) >= confidence; n + 1 if there is
// none. The left side is the probability of at most k - 1 successes in n trials, each of which
// succeeds with probability 1 - alpha.
double ToleranceRank(double n, double alpha, double confidence) {
  double sum = 0.0;
  for (double k = 0.0; k < n; ++k) {
    sum +=
        std::exp(core::LogGamma(n + 1.0) - core::LogGamma(k + 1.0) - core::LogGamma(n - k + 1.0) +
                 k * std::log1p(-alpha) + (n - k) * std::log(alpha));
    if (sum >= confidence) return k + 1.0;
  }
  return n + 1.0;
}

}  // namespace

double ConformalThreshold(std::span<const double> scores, double alpha, double confidence) {
  DFR_THROW_UNLESS(!scores.empty(), "there are no held-out scores");
  DFR_THROW_UNLESS(alpha > 0.0 && alpha < 1.0, "alpha must lie in (0, 1), not " << alpha);
  std::vector<double> sorted(scores.begin(), scores.end());
  for (const double s : sorted) DFR_THROW_UNLESS(!std::isnan(s), "a held-out score is NaN");
  const double n = static_cast<double>(sorted.size());
  // Subtracting 1e-9 keeps (n + 1)(1 - alpha) = 9.000000000000002 at rank 9.
  const double mean_rank = std::ceil((n + 1.0) * (1.0 - alpha) - 1e-9);
  DFR_THROW_UNLESS(confidence >= 0.0 && confidence < 1.0,
                   "confidence must lie in [0, 1), not " << confidence);
  const double rank = confidence > 0.0 ? ToleranceRank(n, alpha, confidence) : mean_rank;
  if (rank > n) return std::numeric_limits<double>::infinity();
  const auto index = static_cast<std::ptrdiff_t>(std::max(rank, 1.0)) - 1;
  std::nth_element(sorted.begin(), sorted.begin() + index, sorted.end());
  return sorted[static_cast<std::size_t>(index)];
}

double ExcursionScore(const TimeVaryingSupport& support, const core::Matrix& states) {
  double score = -std::numeric_limits<double>::infinity();
  for (Eigen::Index t = 0; t < states.rows(); ++t) {
    score = std::max(score, -support.at(static_cast<int>(t)).LogDecision(core::Row(states, t)));
  }
  return score;
}

Selection SelectModel(std::span<const core::Matrix> demonstrations,
                      const SelectionOptions& options) {
  internal::CheckDemonstrations(internal::Views(demonstrations));
  CheckOptions(options, demonstrations.size());
  const std::span<const double> all_weights = options.support.svm.weights;
  DFR_THROW_UNLESS(all_weights.empty() || all_weights.size() == demonstrations.size(),
                   "there are " << all_weights.size() << " weights for " << demonstrations.size()
                                << " demonstrations");
  const std::vector<int> fold = AssignFolds(demonstrations.size(), options);
  const core::Matrix draws = DrawFromBox(demonstrations, options.seed);
  std::vector<internal::NuGamma> grid;
  for (const double nu : options.nus) {
    for (const double gamma : options.gammas) grid.push_back({nu, gamma});
  }
  // Pooled fits run in parallel over the folds, other fits over the time steps of one fold.
  const bool pooled = options.support.pooled;
  TimeVaryingSupportOptions support = options.support;
  if (pooled) support.threads = 1;
  support.svm.start = {};
  internal::SharedProgress progress(options.support.svm.progress);
  support.svm.progress = progress.callback();
  const auto folds = static_cast<std::size_t>(options.folds);
  std::vector<std::vector<Tally>> of_fold(folds, std::vector<Tally>(grid.size()));
  core::Workers workers(pooled ? options.support.threads : 1);
  workers.Run(folds, [&](std::size_t held_out) {
    std::vector<core::Matrix> training;
    std::vector<double> weights;
    std::vector<const core::Matrix*> held;
    for (std::size_t i = 0; i < demonstrations.size(); ++i) {
      if (fold[i] == static_cast<int>(held_out)) {
        held.push_back(&demonstrations[i]);
      } else {
        training.push_back(demonstrations[i]);
        if (!all_weights.empty()) weights.push_back(all_weights[i]);
      }
    }
    TimeVaryingSupportOptions of_training = support;
    of_training.svm.weights = weights;
    const std::vector<TimeVaryingSupport> supports =
        internal::FitGrid(internal::Views(training), of_training, grid);
    for (std::size_t g = 0; g < grid.size(); ++g) {
      of_fold[held_out][g].Add(supports[g], held, draws);
    }
  });
  std::vector<Tally> tallies(grid.size());
  for (const std::vector<Tally>& counted : of_fold) {
    for (std::size_t g = 0; g < grid.size(); ++g) tallies[g].Add(counted[g]);
  }
  Selection selection;
  for (std::size_t g = 0; g < grid.size(); ++g) {
    selection.rows.push_back(tallies[g].Row(grid[g], options, draws.rows()));
  }
  const auto better = [&](const SelectionRow& a, const SelectionRow& b) {
    const bool a_accepts = a.acceptance >= options.acceptance;
    const bool b_accepts = b.acceptance >= options.acceptance;
    if (a_accepts != b_accepts) return a_accepts;
    return a_accepts ? a.volume < b.volume : a.acceptance > b.acceptance;
  };
  for (std::size_t i = 1; i < selection.rows.size(); ++i) {
    if (better(selection.rows[i], selection.rows[selection.chosen])) selection.chosen = i;
  }
  selection.accepted = selection.rows[selection.chosen].acceptance >= options.acceptance;
  return selection;
}

std::string Selection::Table() const {
  std::string text =
      "        nu     gamma  inside   never left   threshold  support vectors   volume\n";
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const SelectionRow& r = rows[i];
    text +=
        core::Format("%s %8.4g  %8.4g  %5.1f %%      %5.1f %%   %9.4g  %15.1f  %5.1f %%\n",
                     i == chosen ? "->" : "  ", r.nu, r.gamma, 100.0 * r.acceptance,
                     100.0 * r.inside_throughout, r.threshold, r.support_vectors, 100.0 * r.volume);
  }
  return text;
}

}  // namespace dfr::kernel
