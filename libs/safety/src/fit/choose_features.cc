#include "fit/choose_features.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/features/absolute_actions.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/numerics/local_scatter.h"
#include "dfr/core/text/format.h"
#include "dfr/safety/constants.h"

namespace dfr::safety::internal {
namespace {

// A fit that its callback stopped.
struct Stopped {};

// A choice of features, and the fraction of left-out states inside with it.
struct Candidate {
  std::string spec;
  double inside = 0.0;
};

std::optional<Candidate> Try(const core::StateLayout& layout, const std::string& spec,
                             const Recorded& recorded,
                             const kernel::WhitenedSupportOptions& options,
                             const ActionSpace& actions, int folds, const StageCallback& going_on) {
  try {
    const Recorded part(
        core::FeatureSelection(layout, spec).Mapped(recorded.features.selection().map()),
        recorded.ordered, core::DeterministicOrder(recorded.ordered), &actions);
    const std::optional<GuardFit> fit = FitGuard(
        part, options, folds,
        [&](std::string_view, double) { return going_on("comparing features", 0.8); }, false);
    if (!fit) throw Stopped();
    return Candidate{spec, fit->left_out.acceptance()};
  } catch (const std::invalid_argument&) {
    return std::nullopt;  // No entry differs between demonstrations.
  }
}

// Formats entries as a selection, in the given order: "object[0:2],tip[1:2]".
std::string Spec(const core::StateLayout& layout, const std::vector<int>& entries) {
  std::string spec;
  for (std::size_t i = 0; i < entries.size();) {
    const auto block = std::find_if(layout.blocks.begin(), layout.blocks.end(),
                                    [&](const auto& b) { return entries[i] < b.offset + b.size; });
    std::size_t end = i + 1;
    while (end < entries.size() && entries[end] == entries[end - 1] + 1 &&
           entries[end] < block->offset + block->size) {
      ++end;
    }
    spec +=
        (spec.empty() ? "" : ",") + block->name +
        core::Format("[%d:%d]", entries[i] - block->offset, entries[end - 1] + 1 - block->offset);
    i = end;
  }
  return spec;
}

// Finds entries that determine the others almost linearly: a pivoted Cholesky decomposition of the
// correlation between demonstrations at the same time step, until 1 % of the variance remains.
std::vector<int> Independent(const Recorded& recorded) {
  constexpr double kConstant = 1e-9;
  const core::FeatureSelection& selection = recorded.features.selection();
  std::vector<core::Matrix> states;
  for (const core::Trajectory& d : recorded.ordered) states.push_back(selection.Apply(d.states));
  std::vector<core::Matrix> steps;
  for (int t = 0; t < core::MedianNumStates(states); ++t) {
    core::Matrix here(0, selection.num_features());
    for (const core::Matrix& x : states) {
      if (t >= x.rows()) continue;
      here.conservativeResize(here.rows() + 1, Eigen::NoChange);
      here.bottomRows(1) = x.row(t);
    }
    steps.push_back(std::move(here));
  }
  Eigen::MatrixXd left = core::PooledCovariance(steps);
  Eigen::VectorXd sd = left.diagonal().cwiseSqrt();
  // Constant entries have no variance to explain.
  sd = (sd.array() > kConstant * sd.maxCoeff()).select(sd.cwiseInverse(), 0.0);
  left = sd.asDiagonal() * left * sd.asDiagonal();
  const double all = left.trace();
  std::vector<int> chosen;
  Eigen::Index pivot = 0;
  while (left.trace() > fit::kLeftVariance * all && left.diagonal().maxCoeff(&pivot) > 0.0) {
    chosen.push_back(selection.indices()[static_cast<std::size_t>(pivot)]);
    const Eigen::VectorXd column = left.col(pivot) / std::sqrt(left(pivot, pivot));
    left -= column * column.transpose();
    left.diagonal() = left.diagonal().cwiseMax(0.0);
    left.row(pivot).setZero();
    left.col(pivot).setZero();
  }
  std::sort(chosen.begin(), chosen.end());
  chosen.erase(std::unique(chosen.begin(), chosen.end()), chosen.end());
  return chosen;
}

// Returns the sum of squared residuals of a linear regression of y on the columns of x.
double Left(const Eigen::MatrixXd& x, const Eigen::VectorXd& y) {
  return (y - x * core::SolveLeastSquares(x, y)).squaredNorm();
}

std::string Share(double share) { return core::Format("%.0f %%", 100.0 * share); }

}  // namespace

std::vector<core::Rotation> Rotations(const core::FeatureSelection& features,
                                      const core::StateLayout& layout,
                                      std::span<const core::Trajectory> demonstrations) {
  std::vector<core::Rotation> rotations = core::FindRotations(layout, demonstrations);
  std::erase_if(rotations, [&](const core::Rotation& rotation) {
    return std::none_of(features.indices().begin(), features.indices().end(), [&](int entry) {
      return entry >= rotation.first && entry < rotation.first + rotation.size;
    });
  });
  return rotations;
}

core::FeatureSelection Continuous(const core::FeatureSelection& features,
                                  const core::StateLayout& layout,
                                  std::span<const core::Trajectory> demonstrations) {
  return features.Mapped(core::MapOf(Rotations(features, layout, demonstrations)));
}

std::vector<int> MovedByPassed(const core::FeatureSelection& features, const ActionSpace& actions,
                               std::span<const core::Trajectory> demonstrations,
                               std::span<const std::size_t> order) {
  constexpr std::size_t kSamples = 4000;
  constexpr double kRounding = 1e-9;  // A negligible fraction of the squared changes.
  const auto steered = static_cast<Eigen::Index>(actions.steered_dim());
  const Eigen::Index passed = actions.dim() - steered;
  if (passed == 0) return {};
  std::size_t transitions = 0;
  for (const auto& d : demonstrations) transitions += static_cast<std::size_t>(d.controls.rows());
  const std::size_t stride = std::max<std::size_t>(1, transitions / kSamples);
  const auto rows = static_cast<Eigen::Index>((transitions + stride - 1) / stride);
  // The columns are 1, the entry, the steered entries of the action, and the unsteered entries.
  Eigen::MatrixXd x = Eigen::MatrixXd::Ones(rows, 2 + actions.dim());
  std::vector<Eigen::VectorXd> before(features.indices().size(), Eigen::VectorXd(rows));
  std::vector<Eigen::VectorXd> change(before);
  std::size_t sample = 0;
  Eigen::Index row = 0;
  for (const std::size_t episode : order) {
    const core::Trajectory& d = demonstrations[episode];
    for (Eigen::Index t = 0; t < d.controls.rows(); ++t, ++sample) {
      if (sample % stride != 0) continue;
      for (std::size_t k = 0; k < before.size(); ++k) {
        const int entry = features.indices()[k];
        before[k][row] = d.states(t, entry);
        change[k][row] = d.states(t + 1, entry) - d.states(t, entry);
      }
      Eigen::Index next_steered = 2;
      Eigen::Index next_passed = 2 + steered;
      for (std::size_t i = 0; i < actions.entries().size(); ++i) {
        Eigen::Index& column = actions.entries()[i].steered ? next_steered : next_passed;
        x(row, column++) = d.controls(t, static_cast<Eigen::Index>(i));
      }
      ++row;
    }
  }
  std::vector<Eigen::Index> without_steered = {0, 1};
  for (Eigen::Index i = 2 + steered; i < x.cols(); ++i) without_steered.push_back(i);
  std::vector<int> moved;
  for (std::size_t k = 0; k < before.size(); ++k) {
    x.col(1) = before[k];
    const double all = change[k].squaredNorm();
    const double alone = Left(x.leftCols(2), change[k]);
    const double by_steered = Left(x.leftCols(2 + steered), change[k]);
    const double by_passed = Left(x(Eigen::all, without_steered), change[k]);
    const double by_both = Left(x, change[k]);
    // Steered entries often move together with unsteered ones, and then explain part of the change.
    if (by_steered > kRounding * all && by_passed - by_both <= fit::kSteeredExplain * alone &&
        by_steered - by_both > fit::kPassedExplain * by_steered) {
      moved.push_back(features.indices()[k]);
    }
  }
  return moved.size() < before.size() ? moved : std::vector<int>{};
}

core::FeatureTransform Context(const core::StateLayout& layout, const std::vector<int>& entries,
                               std::span<const core::Trajectory> demonstrations) {
  core::FeatureSelection selection = Continuous(Only(layout, entries), layout, demonstrations);
  const Eigen::Index n = selection.num_features();
  Eigen::VectorXd low = Eigen::VectorXd::Constant(n, std::numeric_limits<double>::infinity());
  Eigen::VectorXd high = -low;
  for (const core::Trajectory& d : demonstrations) {
    const core::Matrix values = selection.Apply(d.states);
    low = low.cwiseMin(values.colwise().minCoeff().transpose());
    high = high.cwiseMax(values.colwise().maxCoeff().transpose());
  }
  const Eigen::VectorXd unit = fit::kContextUnit * (high - low);
  core::Matrix scale = core::Matrix::Zero(n, n);
  for (Eigen::Index k = 0; k < n; ++k) scale(k, k) = unit[k] > 0.0 ? 1.0 / unit[k] : 0.0;
  return {std::move(selection), low, std::move(scale)};
}

std::vector<int> ConstantEntries(const core::FeatureSelection& features,
                                 std::span<const core::Trajectory> demonstrations) {
  constexpr double kRounding = 1e-12;  // Tolerance relative to the value, or to 1.
  std::vector<int> constant;
  for (const int entry : features.indices()) {
    double low = demonstrations[0].states(0, entry);
    double high = low;
    for (const core::Trajectory& d : demonstrations) {
      low = std::min(low, d.states.col(entry).minCoeff());
      high = std::max(high, d.states.col(entry).maxCoeff());
    }
    if (high - low <= kRounding * std::max({1.0, std::abs(low), std::abs(high)})) {
      constant.push_back(entry);
    }
  }
  return std::ssize(constant) < features.num_features() ? constant : std::vector<int>{};
}

std::vector<core::Trajectory> WithoutConstants(std::span<const core::Trajectory> demonstrations) {
  const auto all = core::FeatureSelection::All(static_cast<int>(demonstrations[0].states.cols()));
  const std::vector<int> constant = ConstantEntries(all, demonstrations);
  std::vector<core::Trajectory> varying;
  if (constant.empty()) return varying;
  std::vector<int> kept = all.indices();
  std::erase_if(kept, [&](int entry) { return std::ranges::count(constant, entry) > 0; });
  varying.assign(demonstrations.begin(), demonstrations.end());
  for (core::Trajectory& d : varying) d.states = core::Matrix(d.states(Eigen::all, kept));
  return varying;
}

std::vector<core::Trajectory> WithoutJumps(const core::StateLayout& layout,
                                           std::span<const core::Trajectory> demonstrations) {
  const std::vector<core::Rotation> rotations = core::FindRotations(layout, demonstrations);
  std::vector<core::Trajectory> steady(demonstrations.begin(), demonstrations.end());
  for (core::Trajectory& d : steady) core::RemoveJumps(rotations, d.states);
  return steady;
}

std::string Names(const core::StateLayout& layout, std::span<const int> entries) {
  constexpr std::size_t kMost = 8;
  std::string names;
  for (std::size_t i = 0; i < std::min(kMost, entries.size()); ++i) {
    names.append(names.empty() ? "" : ", ").append(core::EntryName(layout, entries[i]));
  }
  if (entries.size() > kMost) names += core::Format(" and %zu others", entries.size() - kMost);
  return names;
}

core::FeatureSelection Only(const core::StateLayout& layout, const std::vector<int>& entries) {
  return core::FeatureSelection::Of(layout, Spec(layout, entries));
}

core::FeatureSelection Without(const core::FeatureSelection& features,
                               const core::StateLayout& layout, std::span<const int> entries) {
  std::vector<int> kept = features.indices();
  kept.erase(std::unique(kept.begin(), kept.end()), kept.end());
  std::erase_if(kept, [&](int entry) { return std::ranges::count(entries, entry) > 0; });
  return core::FeatureSelection::Of(layout, Spec(layout, kept));
}

std::vector<core::Trajectory> Mapped(const core::StateMap& map,
                                     std::span<const core::Trajectory> demonstrations) {
  std::vector<core::Trajectory> mapped(demonstrations.begin(), demonstrations.end());
  for (core::Trajectory& demonstration : mapped) {
    for (Eigen::Index t = 0; t < demonstration.states.rows(); ++t) {
      map.Apply(core::Row(demonstration.states, t));
    }
  }
  return mapped;
}

bool RefuseUnlessInside(const core::StateLayout& layout, const Recorded& recorded,
                        const GuardFit& fit, const ActionSpace& actions, int folds,
                        const StageCallback& going_on) try {
  const double inside = fit.left_out.acceptance();
  if (inside >= fit::kLeastInside) return true;
  const core::FeatureSelection& selection = recorded.features.selection();
  std::vector<Candidate> candidates;
  const auto consider = [&](const std::string& spec) {
    auto candidate = Try(layout, spec, recorded, fit.options, actions, folds, going_on);
    if (candidate && candidate->inside > inside) candidates.push_back(*std::move(candidate));
  };
  for (const auto& block : layout.blocks) {
    const bool looked_at = std::any_of(
        selection.indices().begin(), selection.indices().end(),
        [&](int entry) { return entry >= block.offset && entry < block.offset + block.size; });
    if (looked_at && block.size < selection.num_features()) consider(block.name);
  }
  const auto sort = [&] {
    std::stable_sort(candidates.begin(), candidates.end(),
                     [](const Candidate& a, const Candidate& b) { return a.inside > b.inside; });
  };
  sort();
  // A single block rarely suffices. The choice with the most blocks comes first.
  std::optional<Candidate> joint;
  for (const Candidate& block : candidates) {
    if (block.inside < fit::kLeastInside) break;
    const std::string spec = joint ? joint->spec + "," + block.spec : block.spec;
    auto more = joint ? Try(layout, spec, recorded, fit.options, actions, folds, going_on) : block;
    if (more && more->inside >= fit::kLeastInside) joint = std::move(more);
  }
  const std::vector<int> independent = Independent(recorded);
  const bool redundant = std::ssize(independent) < selection.num_features();
  if (redundant) consider(Spec(layout, independent));
  sort();
  if (joint && joint->spec.find(',') != std::string::npos) {
    candidates.insert(candidates.begin(), *std::move(joint));
  }
  constexpr std::size_t kMostNamed = 3;
  std::string better;
  for (std::size_t i = 0; i < std::min(kMostNamed, candidates.size()); ++i) {
    better += (i == 0 ? "" : "; ") + candidates[i].spec + " (" + Share(candidates[i].inside) + ")";
  }
  std::string message =
      "only " + Share(inside) +
      " of the states of left-out demonstrations are inside: the guard would halt almost every "
      "policy. ";
  if (redundant) {
    message += core::Format("The %d features follow from %zu of them: ", selection.num_features(),
                            independent.size()) +
               Spec(layout, independent) + ". ";
  }
  message +=
      better.empty()
          ? "Record more demonstrations, or use features relative to objects and goals"
          : "Use fewer features, but not without goals (in brackets the share inside): " + better;
  if (fit.options.svm.gamma > kernel::WhitenedSupportOptions().svm.gamma) {
    message += core::Format(", or choose a smaller gamma than %g", fit.options.svm.gamma);
  }
  throw std::invalid_argument(message + ". To fit anyway, use --accept-any or accept_any=True");
} catch (const Stopped&) {
  return false;
}

}  // namespace dfr::safety::internal
