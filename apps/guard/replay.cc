#include "replay.h"

#include <algorithm>
#include <cmath>
#include <span>
#include <stdexcept>

#include "dfr/core/features/feature_transform.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/guard.h"

namespace dfr::apps::guard {
namespace {

// Names the blocks of a state with their sizes, as in "object (2), tip (3)".
std::string Named(const core::StateLayout& layout) {
  std::string names;
  for (const auto& block : layout.blocks) {
    names += (names.empty() ? "" : ", ") + block.name + " (" + std::to_string(block.size) + ")";
  }
  return names;
}

}  // namespace

std::unique_ptr<imitation::DemonstrationReader> OpenEpisodes(const safety::GuardModel& model,
                                                             const std::filesystem::path& path,
                                                             const std::string& filter_key) {
  auto reader =
      imitation::OpenDemonstrations(path, filter_key, imitation::PictureRequests(model.layout()));
  if (reader->layout() != model.layout()) {
    throw std::runtime_error(
        path.string() + ": states consist of " + Named(reader->layout()) +
        ", but the guard's consist of " + Named(model.layout()) +
        ": use episodes with the guard's states, or fit a guard to these episodes");
  }
  const int expected = model.action_dim();
  if (reader->control_dim() != expected) {
    throw std::runtime_error(
        path.string() + ": actions have " + std::to_string(reader->control_dim()) +
        " entries, but the guard's have " + std::to_string(expected) +
        ": use episodes with the guard's actions, or fit a guard to these episodes");
  }
  return reader;
}

bool CanCertify(const safety::GuardModel& model) {
  return model.settings().direction_error > 0.0 && !model.task().single_precision();
}

void Drivers::Add(const core::Matrix& states, const std::vector<int>& steps) {
  std::vector<double> gradient(static_cast<std::size_t>(model_->task_layout().state_dim()));
  for (Eigen::Index i = 0; i < states.rows(); ++i) {
    const double l = model_->support().LogDecision(steps[static_cast<std::size_t>(i)],
                                                   core::Row(states, i), gradient);
    if (std::isfinite(l)) sums_ += core::AsVector(std::span<const double>(gradient)).cwiseAbs();
  }
  states_.push_back(states);
}

std::vector<std::pair<double, int>> Drivers::Ranked() const {
  Eigen::VectorXd weights = sums_;
  const Eigen::VectorXd spread = Spread();
  weights = weights.cwiseProduct(spread);
  const double total = weights.sum();
  std::vector<std::pair<double, int>> ranked;
  std::vector<int> entries = model_->task().features().selection().indices();
  std::sort(entries.begin(), entries.end());
  entries.erase(std::unique(entries.begin(), entries.end()), entries.end());
  ranked.reserve(entries.size());
  for (const int k : entries) ranked.emplace_back(total > 0.0 ? weights[k] / total : 0.0, k);
  std::sort(ranked.rbegin(), ranked.rend());
  return ranked;
}

Eigen::VectorXd Drivers::Spread() const {
  const Eigen::Index n = model_->task_layout().state_dim();
  Eigen::VectorXd scatter = Eigen::VectorXd::Zero(n);
  double count = 0.0;
  Eigen::Index longest = 0;
  for (const core::Matrix& states : states_) longest = std::max(longest, states.rows());
  for (Eigen::Index t = 0; t < longest; ++t) {
    Eigen::VectorXd mean = Eigen::VectorXd::Zero(n);
    double here = 0.0;
    for (const core::Matrix& states : states_) {
      if (t >= states.rows()) continue;
      mean += states.row(t).transpose();
      here += 1.0;
    }
    if (here < 2.0) break;
    mean /= here;
    for (const core::Matrix& states : states_) {
      if (t < states.rows()) scatter += (states.row(t).transpose() - mean).cwiseAbs2();
    }
    count += here - 1.0;
  }
  if (count == 0.0) return Eigen::VectorXd::Ones(n);
  return (scatter / count).cwiseSqrt();
}

Strays::Strays(const safety::GuardModel& model)
    : model_(&model), features_(static_cast<std::size_t>(model.num_steps())) {}

void Strays::Add(const core::Matrix& states, const std::vector<int>& steps) {
  const core::Matrix points = model_->task().features().Apply(states);
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    if (!points.row(i).allFinite()) continue;
    const int t = std::clamp(steps[static_cast<std::size_t>(i)], 0, model_->num_steps() - 1);
    features_[static_cast<std::size_t>(t)].emplace_back(points.row(i).transpose());
  }
}

std::map<std::string, std::vector<double>> Strays::Distances() const {
  const core::FeatureTransform& transform = model_->task().features();
  const kernel::WhitenedSupport& support = model_->task().feature_support();
  const std::vector<int>& entries = transform.selection().indices();
  std::map<std::string, std::vector<Eigen::Index>> columns;
  for (const auto& block : model_->task_layout().blocks) {
    for (std::size_t k = 0; k < entries.size(); ++k) {
      if (entries[k] < block.offset || entries[k] >= block.offset + block.size) continue;
      columns[block.name].push_back(static_cast<Eigen::Index>(k));
    }
  }
  std::map<std::string, std::vector<double>> distances;
  for (int t = 0; t < support.num_steps(); ++t) {
    const auto& points = features_[static_cast<std::size_t>(t)];
    if (points.empty()) continue;
    const core::Matrix& vectors = support.estimate(t).support_vectors();
    // Maps whitened features to the units of the state, as safety::Clearances() does.
    const Eigen::MatrixXd inverse = core::PseudoInverse(support.map(t) * transform.scale());
    for (const Eigen::VectorXd& z : points) {
      const Eigen::VectorXd y = support.map(t) * z;
      Eigen::Index nearest = 0;
      (vectors.rowwise() - y.transpose()).rowwise().squaredNorm().minCoeff(&nearest);
      const Eigen::VectorXd apart = inverse * (y - vectors.row(nearest).transpose());
      for (const auto& [block, own] : columns) distances[block].push_back(apart(own).norm());
    }
  }
  return distances;
}

std::vector<ReplayedEpisode> Replay(const std::shared_ptr<const safety::GuardModel>& shared,
                                    const std::filesystem::path& path,
                                    const std::string& filter_key, const SeeStates& see) {
  const safety::GuardModel& model = *shared;
  const auto reader = OpenEpisodes(model, path, filter_key);
  std::vector<ReplayedEpisode> episodes;
  safety::Guard guard(shared);
  for (int i = 0; i < reader->num_episodes(); ++i) {
    const core::Trajectory trajectory = reader->Read(i);
    ReplayedEpisode episode{.name = reader->name(i), .levels = {}};
    std::vector<int> steps;
    episode.levels = model.Levels(trajectory.states, &steps);
    if (see) see(model.TaskStates(trajectory.states), steps);
    for (Eigen::Index t = 0; CanCertify(model) && t < trajectory.controls.rows(); ++t) {
      episode.passing +=
          model.Certify(steps[static_cast<std::size_t>(t)], core::Row(trajectory.states, t),
                        core::Row(trajectory.controls, t))
                  .passes
              ? 1
              : 0;
    }
    episode.shadow = safety::RunInShadow(guard, trajectory);
    episode.lowest = *std::min_element(episode.levels.begin(), episode.levels.end());
    episode.inside = static_cast<double>(std::count_if(episode.levels.begin(), episode.levels.end(),
                                                       [](double l) { return l >= 0.0; })) /
                     static_cast<double>(episode.levels.size());
    for (std::size_t t = 0; t < episode.levels.size() && episode.first_alarm < 0; ++t) {
      if (episode.levels[t] < -model.settings().alarm_level) {
        episode.first_alarm = static_cast<int>(t);
      }
    }
    episodes.push_back(std::move(episode));
  }
  if (episodes.empty()) throw std::runtime_error(path.string() + ": holds no episode");
  return episodes;
}

}  // namespace dfr::apps::guard
