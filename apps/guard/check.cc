#include <algorithm>
#include <cstddef>
#include <cstdio>
#include <functional>
#include <limits>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "commands.h"
#include "dfr/core/features/absolute_actions.h"
#include "dfr/core/features/features.h"
#include "dfr/core/features/rotations.h"
#include "dfr/core/matrix.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/text/format.h"
#include "dfr/imitation/demonstrations.h"

namespace dfr::apps::guard {
namespace {

using core::EntryName;

std::size_t HashOf(const core::Matrix& m) {
  return std::hash<std::string_view>()({reinterpret_cast<const char*>(m.data()),
                                        static_cast<std::size_t>(m.size()) * sizeof(double)});
}

// Prints problems as they are found, up to a limit for each kind.
class Problems {
 public:
  void Error(const std::string& what) { Say("error", what, errors_); }
  void Warning(const std::string& kind, const std::string& what) { Say(kind, what, counts_[kind]); }
  [[nodiscard]] int errors() const { return errors_; }
  [[nodiscard]] int warnings() const {
    int sum = 0;
    for (const auto& [kind, count] : counts_) sum += count;
    return sum;
  }

 private:
  void Say(const std::string& kind, const std::string& what, int& count) {
    constexpr int kMost = 10;
    if (++count <= kMost) Print("%-10s %s\n", (kind + ":").c_str(), what.c_str());
    if (count == kMost + 1) Print("%-10s ... and more\n", (kind + ":").c_str());
  }
  int errors_ = 0;
  std::map<std::string, int> counts_;
};

// Linear regression of the change of states on actions, one episode at a time.
class LaggedFit {
 public:
  LaggedFit(Eigen::Index state_dim, Eigen::Index action_dim)
      : u_(Eigen::VectorXd::Zero(action_dim)),
        x_(Eigen::VectorXd::Zero(state_dim)),
        uu_(Eigen::MatrixXd::Zero(action_dim, action_dim)),
        ux_(Eigen::MatrixXd::Zero(action_dim, state_dim)),
        xx_(Eigen::VectorXd::Zero(state_dim)) {}

  // Pairs the change of the state during step t with the action of step t + lag.
  void Add(const core::Trajectory& episode, Eigen::Index lag) {
    // Every lag uses the same changes: otherwise fits are not comparable.
    for (Eigen::Index t = 1; t + 1 < episode.controls.rows(); ++t) {
      const Eigen::VectorXd change = episode.states.row(t + 1) - episode.states.row(t);
      const Eigen::VectorXd action = episode.controls.row(t + lag);
      u_ += action;
      x_ += change;
      uu_ += action * action.transpose();
      ux_ += action * change.transpose();
      xx_ += change.cwiseAbs2();
      ++count_;
    }
  }

  // Returns, per state entry, the share of the variance of its changes that actions explain.
  [[nodiscard]] Eigen::VectorXd Shares() const {
    Eigen::VectorXd shares = Eigen::VectorXd::Zero(xx_.size());
    if (count_ == 0) return shares;
    Eigen::MatrixXd uu = uu_ - u_ * u_.transpose() / count_;
    uu.diagonal().array() += 1e-9 * uu.trace() + 1e-300;
    const Eigen::MatrixXd ux = ux_ - u_ * x_.transpose() / count_;
    const Eigen::VectorXd xx = xx_ - x_.cwiseAbs2() / count_;
    const Eigen::VectorXd explained =
        (ux.array() * core::SolveSymmetric(uu, ux).array()).colwise().sum();
    for (Eigen::Index k = 0; k < xx.size(); ++k) {
      // The rounding error of a constant change is not variance.
      if (xx[k] > 1e-12 * xx_[k]) shares[k] = explained[k] / xx[k];
    }
    return shares;
  }

 private:
  Eigen::VectorXd u_;
  Eigen::VectorXd x_;
  Eigen::MatrixXd uu_;
  Eigen::MatrixXd ux_;
  Eigen::VectorXd xx_;
  double count_ = 0.0;
};

// Statistics over all episodes. Stores one episode at a time, and all quaternions.
class Collected {
 public:
  Collected(const core::StateLayout& layout, int action_dim)
      : layout_(&layout),
        low_(
            Eigen::VectorXd::Constant(layout.state_dim(), std::numeric_limits<double>::infinity())),
        high_(-low_),
        action_low_(Eigen::VectorXd::Constant(action_dim, std::numeric_limits<double>::infinity())),
        action_high_(-action_low_),
        differ_(layout.state_dim(), layout.state_dim()),
        fits_(3, LaggedFit(layout.state_dim(), action_dim)),
        actions_(layout.state_dim(), action_dim),
        rotations_(layout) {
    differ_.setConstant(false);
  }

  void Add(const core::Trajectory& episode) {
    const core::Matrix& x = episode.states;
    const core::Matrix& u = episode.controls;
    low_ = low_.cwiseMin(x.colwise().minCoeff().transpose());
    high_ = high_.cwiseMax(x.colwise().maxCoeff().transpose());
    action_low_ = action_low_.cwiseMin(u.colwise().minCoeff().transpose());
    action_high_ = action_high_.cwiseMax(u.colwise().maxCoeff().transpose());
    for (Eigen::Index a = 0; a < x.cols(); ++a) {
      for (Eigen::Index b = 0; b < a; ++b) {
        if (!differ_(a, b)) differ_(a, b) = (x.col(a) != x.col(b));
      }
    }
    for (std::size_t i = 0; i < fits_.size(); ++i) {
      fits_[i].Add(episode, static_cast<Eigen::Index>(i) - 1);
    }
    actions_.Add(episode);
    rotations_.Add(episode.states);
    steps_.push_back(episode.num_steps());
  }

  void Report(Problems& problems) {
    for (Eigen::Index k = 0; k < low_.size(); ++k) {
      if (low_[k] == high_[k]) {
        problems.Warning("dead", EntryName(*layout_, k) + " is always " + std::to_string(low_[k]) +
                                     ": leave it out of --features");
      }
    }
    Doubled(problems);
    for (Eigen::Index k = 0; k < action_low_.size(); ++k) {
      if (action_low_[k] == action_high_[k]) {
        problems.Warning(
            "dead", "action " + std::to_string(k) + " is always " + std::to_string(action_low_[k]));
      }
    }
    Alignment(problems);
    Rotations(problems);
    Actions(problems);
    std::sort(steps_.begin(), steps_.end());
    Print(
        "%zu episodes of %d to %d actions (median %d), states of %ld entries, actions of %ld "
        "within [%.4g, %.4g]\n",
        steps_.size(), steps_.front(), steps_.back(), steps_[steps_.size() / 2],
        static_cast<long>(low_.size()), static_cast<long>(action_low_.size()),
        action_low_.minCoeff(), action_high_.maxCoeff());
  }

 private:
  // Warns of entries that always equal another entry: one line for each, or a single line for many.
  void Doubled(Problems& problems) const {
    constexpr std::size_t kFew = 3;
    std::vector<std::string> pairs;
    for (Eigen::Index k = 0; k < low_.size(); ++k) {
      for (Eigen::Index b = 0; b < k; ++b) {
        if (differ_(k, b) || low_[k] == high_[k]) continue;
        pairs.push_back(EntryName(*layout_, k) + " always equals " + EntryName(*layout_, b));
        break;
      }
    }
    if (pairs.size() > kFew) {
      problems.Warning("doubled",
                       core::Format("%zu entries repeat others, for example %s: keep one of each",
                                    pairs.size(), pairs[0].c_str()));
      return;
    }
    for (const std::string& pair : pairs) {
      problems.Warning("doubled", pair + ": keep one of them");
    }
  }

  void Rotations(Problems& problems) const {
    for (const core::Rotation& rotation : rotations_.Find()) {
      const std::string text = core::Describe(rotation, *layout_);
      if (rotation.mapped()) {
        Print("rotation   %s\n", text.c_str());
      } else {
        problems.Warning("rotation", text);
      }
    }
  }

  // Finds actions that are positions: with such actions a guard would confuse "hold still" with "go
  // to zero".
  void Actions(Problems& problems) const {
    const auto absolute = actions_.Absolute();
    if (absolute.empty()) {
      Print("actions    are not positions of the state's entries, but velocities or increments\n");
      return;
    }
    problems.Error(
        core::Describe(absolute, *layout_) +
        ". A guard needs velocities or increments: guard convert --differences makes them");
  }

  void Alignment(Problems& problems) const {
    // Actions best explain the changes of the entries that they move. Actions of neighbouring steps
    // must not explain these changes better.
    constexpr double kClearly = 0.1;
    const Eigen::VectorXd as_recorded = fits_[1].Shares();
    for (const std::size_t i : {std::size_t{0}, std::size_t{2}}) {
      const Eigen::VectorXd moved = fits_[i].Shares();
      Eigen::Index entry = 0;
      const double share = moved.maxCoeff(&entry);
      if (share <= as_recorded[entry] + kClearly || share <= as_recorded.maxCoeff() + kClearly) {
        continue;
      }
      const std::string text = core::Format(
          "the change of %s after step t is explained to %.0f %% by the action of step "
          "t %c 1, but to %.0f %% by the action of step t: check whether actions and states are "
          "out of step",
          EntryName(*layout_, entry).c_str(), 100.0 * share, i == 0 ? '-' : '+',
          100.0 * as_recorded[entry]);
      problems.Warning("alignment", text);
    }
  }

  const core::StateLayout* layout_;
  Eigen::VectorXd low_;
  Eigen::VectorXd high_;
  Eigen::VectorXd action_low_;
  Eigen::VectorXd action_high_;
  Eigen::Matrix<bool, Eigen::Dynamic, Eigen::Dynamic> differ_;  // below the diagonal
  std::vector<LaggedFit> fits_;
  core::ActionAnalysis actions_;
  core::RotationFinder rotations_;
  std::vector<int> steps_;
};

void CheckActions(const std::string& name, const core::Matrix& actions, double limit,
                  Problems& problems) {
  Eigen::Index t = 0;
  Eigen::Index k = 0;
  const double largest = actions.cwiseAbs().maxCoeff(&t, &k);
  if (largest > limit) {
    problems.Warning("bounds", name + ", action " + std::to_string(k) + " is " +
                                   core::Format("%g at step %d, beyond +-%g", actions(t, k),
                                                static_cast<int>(t), limit));
  }
  if (actions.rows() < 3) {
    problems.Warning("short", name + " has " + std::to_string(actions.rows()) + " actions");
  }
}

}  // namespace

bool RunCheck(const CheckOptions& options) {
  const auto reader = imitation::OpenDemonstrations(options.demonstrations, options.filter_key);
  if (!reader->note().empty()) Print("note:      %s\n", reader->note().c_str());
  std::optional<imitation::RobomimicWriter> repaired;
  if (!options.repair.empty()) {
    repaired.emplace(options.repair, reader->layout(), reader->control_dim(),
                     reader->environment());
    repaired->CopyOrigin(*reader);
  }
  Problems problems;
  Collected collected(reader->layout(), reader->control_dim());
  std::map<std::pair<std::size_t, std::size_t>, std::string> seen;  // by HashOf()
  int good = 0;
  for (int i = 0; i < reader->num_episodes(); ++i) {
    core::Trajectory episode;
    try {
      episode = reader->Read(i);
    } catch (const std::runtime_error& e) {
      problems.Error(e.what());
      continue;
    }
    try {
      if (repaired) repaired->Append(episode);
    } catch (const std::invalid_argument& e) {
      problems.Error(reader->name(i) + ": is left out of the repaired file: " + e.what());
    }
    CheckActions(reader->name(i), episode.controls, options.action_limit, problems);
    const auto [first, fresh] =
        seen.emplace(std::pair(HashOf(episode.states), HashOf(episode.controls)), reader->name(i));
    if (!fresh) {
      problems.Warning("doubled", reader->name(i) + " is the same episode as " + first->second);
    }
    collected.Add(episode);
    ++good;
  }
  if (good > 0) collected.Report(problems);
  if (repaired) {
    Print("repaired:  %s has %d of %d episodes\n", options.repair.c_str(), repaired->num_episodes(),
          reader->num_episodes());
  }
  Print("%s: %d error%s, %d warning%s%s\n", options.demonstrations.c_str(), problems.errors(),
        problems.errors() == 1 ? "" : "s", problems.warnings(), problems.warnings() == 1 ? "" : "s",
        problems.errors() > 0 ? "; a fit needs a file without errors" : "");
  return problems.errors() == 0;
}

}  // namespace dfr::apps::guard
