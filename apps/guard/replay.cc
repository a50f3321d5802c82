#include "replay.h"

#include <algorithm>
#include <cmath>
#include <span>
#include <stdexcept>

#include "dfr/imitation/demonstrations.h"
#include "dfr/safety/guard.h"

namespace dfr::apps::guard {

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

std::vector<ReplayedEpisode> Replay(const std::shared_ptr<const safety::GuardModel>& shared,
                                    const std::filesystem::path& path,
                                    const std::string& filter_key, Drivers* drivers) {
  const safety::GuardModel& model = *shared;
  const auto reader =
      imitation::OpenDemonstrations(path, filter_key, imitation::PictureRequests(model.layout()));
  if (reader->layout() != model.layout()) {
    throw std::runtime_error(path.string() + ": its states have different parts than the guard's");
  }
  std::vector<ReplayedEpisode> episodes;
  safety::Guard guard(shared);
  for (int i = 0; i < reader->num_episodes(); ++i) {
    const core::Trajectory trajectory = reader->Read(i);
    ReplayedEpisode episode{.name = reader->name(i), .levels = {}};
    std::vector<int> steps;
    episode.levels = model.Levels(trajectory.states, &steps);
    if (drivers != nullptr) {
      const core::Matrix states = model.TaskStates(trajectory.states);
      drivers->Add(states, steps);
      drivers->AddSpread(states);
    }
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
