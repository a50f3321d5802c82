#include "dfr/kernel/model_selection.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <numeric>
#include <set>
#include <stdexcept>

#include "dfr/core/contract.h"
#include "dfr/core/format.h"
#include "dfr/core/random.h"
#include "fit_sharing.h"

namespace dfr::kernel {
namespace {

void CheckOptions(const SelectionOptions& options, std::size_t demonstrations) {
  DFR_THROW_UNLESS(!options.gammas.empty(), "there is no gamma to choose from");
  DFR_THROW_UNLESS(!options.nus.empty(), "there is no nu to choose from");
  DFR_THROW_UNLESS(options.folds >= 2, "folds must be at least 2, not " << options.folds);
  DFR_THROW_UNLESS(options.acceptance > 0.0 && options.acceptance <= 1.0,
                   "acceptance must lie in (0, 1], not " << options.acceptance);
  DFR_THROW_UNLESS(options.false_alarms > 0.0 && options.false_alarms < 1.0,
                   "false_alarms must lie in (0, 1), not " << options.false_alarms);
  DFR_THROW_UNLESS(demonstrations >= 2 * static_cast<std::size_t>(options.folds),
                   options.folds << " folds need at least " << 2 * options.folds
                                 << " demonstrations; there are " << demonstrations);
}

// Which fold holds each demonstration out.
std::vector<int> AssignFolds(std::size_t demonstrations, const SelectionOptions& options) {
  std::vector<int> fold(demonstrations);
  for (std::size_t i = 0; i < fold.size(); ++i) {
    fold[i] = static_cast<int>(i) % options.folds;
  }
  core::Random random(options.seed);
  random.Shuffle(std::span(fold));
  return fold;
}

// States drawn evenly from the box that holds all demonstrations.
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

// What a row is counted from, over all folds.
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

}  // namespace

double ConformalThreshold(std::span<const double> scores, double alpha) {
  DFR_THROW_UNLESS(!scores.empty(), "there are no held-out scores");
  DFR_THROW_UNLESS(alpha > 0.0 && alpha < 1.0, "alpha must lie in (0, 1), not " << alpha);
  std::vector<double> sorted(scores.begin(), scores.end());
  for (const double s : sorted) DFR_THROW_UNLESS(!std::isnan(s), "a held-out score is NaN");
  const double n = static_cast<double>(sorted.size());
  // 1e-9 keeps (n + 1)(1 - alpha) = 9.000000000000002 at rank 9.
  const double rank = std::ceil((n + 1.0) * (1.0 - alpha) - 1e-9);
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
  CheckOptions(options, demonstrations.size());
  const std::vector<int> fold = AssignFolds(demonstrations.size(), options);
  const core::Matrix draws = DrawFromBox(demonstrations, options.seed);
  std::vector<internal::NuGamma> grid;
  for (const double nu : options.nus) {
    for (const double gamma : options.gammas) grid.push_back({nu, gamma});
  }
  std::vector<Tally> tallies(grid.size());
  for (int held_out = 0; held_out < options.folds; ++held_out) {
    std::vector<core::Matrix> training;
    std::vector<const core::Matrix*> held;
    for (std::size_t i = 0; i < demonstrations.size(); ++i) {
      if (fold[i] == held_out) {
        held.push_back(&demonstrations[i]);
      } else {
        training.push_back(demonstrations[i]);
      }
    }
    const std::vector<TimeVaryingSupport> supports =
        internal::FitGrid(internal::Views(training), options.support, grid);
    for (std::size_t g = 0; g < grid.size(); ++g) tallies[g].Add(supports[g], held, draws);
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

void Selection::SavePicture(const std::filesystem::path& path) const {
  double least = std::numeric_limits<double>::infinity();
  double most = 0.0;
  for (const SelectionRow& r : rows) {
    least = std::min(least, r.gamma);
    most = std::max(most, r.gamma);
  }
  const double span = std::max(std::log(most / least), 1e-9);
  const auto x = [&](double gamma) { return 60.0 + 480.0 * std::log(gamma / least) / span; };
  const auto y = [](double share) { return 320.0 - 280.0 * share; };
  std::ofstream svg(path);
  svg << "<svg xmlns='http://www.w3.org/2000/svg' width='680' height='380' "
         "font-family='sans-serif' font-size='12'>\n<rect width='100%' height='100%' "
         "fill='white'/>\n<text x='60' y='20' font-size='14'>Held-out demonstrations: inside "
         "(full) "
         "and volume (dashed) over gamma</text>\n";
  for (int percent = 0; percent <= 100; percent += 25) {
    svg << "<line x1='60' x2='540' y1='" << y(percent / 100.0) << "' y2='" << y(percent / 100.0)
        << "' stroke='#ddd'/><text x='52' y='" << y(percent / 100.0) + 4 << "' text-anchor='end'>"
        << percent << " %</text>\n";
  }
  static constexpr const char* kColors[] = {"#4878a8", "#e08214", "#5aae61", "#9970ab"};
  std::size_t color = 0;
  for (std::size_t first = 0; first < rows.size();) {
    std::size_t last = first;
    while (last < rows.size() && rows[last].nu == rows[first].nu) ++last;
    for (const bool volume : {false, true}) {
      svg << "<polyline fill='none' stroke='" << kColors[color % 4] << "' stroke-width='2'"
          << (volume ? " stroke-dasharray='5,4'" : "") << " points='";
      for (std::size_t i = first; i < last; ++i) {
        svg << x(rows[i].gamma) << ',' << y(volume ? rows[i].volume : rows[i].acceptance) << ' ';
      }
      svg << "'/>\n";
    }
    svg << "<text x='550' y='" << 60 + 18 * color << "' fill='" << kColors[color % 4]
        << "'>nu = " << rows[first].nu << "</text>\n";
    ++color;
    first = last;
  }
  std::set<double> gammas;
  for (const SelectionRow& r : rows) gammas.insert(r.gamma);
  for (const double gamma : gammas) {
    svg << "<text x='" << x(gamma) << "' y='340' text-anchor='middle'>" << gamma << "</text>\n";
  }
  svg << "<text x='300' y='362' text-anchor='middle'>gamma (circle: chosen)</text>\n";
  const SelectionRow& best = rows.at(chosen);
  svg << "<circle cx='" << x(best.gamma) << "' cy='" << y(best.acceptance)
      << "' r='6' fill='none' stroke='black' stroke-width='2'/>\n</svg>\n";
  svg.flush();
  if (!svg) throw std::runtime_error(path.string() + ": cannot be written");
}

}  // namespace dfr::kernel
