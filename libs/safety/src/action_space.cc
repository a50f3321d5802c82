#include "dfr/safety/action_space.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "dfr/control/response/few_values.h"
#include "dfr/core/contract.h"
#include "dfr/core/numerics/folds.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/text/format.h"
#include "dfr/safety/constants.h"

namespace dfr::safety {
namespace {

// Maximum number of entries of an action in a file.
constexpr int kMostEntries = 1 << 16;

std::vector<int> SteeredOf(const std::vector<ActionEntry>& entries) {
  std::vector<int> steered;
  for (std::size_t i = 0; i < entries.size(); ++i) {
    if (entries[i].steered) steered.push_back(static_cast<int>(i));
  }
  return steered;
}

// Linear response of the changes of a state to an action u, over all demonstrations. It maps u to
// changes dx, and differences of consecutive u to differences of consecutive changes.
struct LinearResponse {
  LinearResponse(std::span<const core::Trajectory> demonstrations,
                 std::span<const std::size_t> order) {
    const Eigen::Index m = demonstrations[0].controls.cols();
    const Eigen::Index n = demonstrations[0].states.cols();
    Eigen::MatrixXd uu = Eigen::MatrixXd::Zero(m, m);
    Eigen::MatrixXd uu_at_once = uu;
    Eigen::MatrixXd ux = Eigen::MatrixXd::Zero(m, n);
    Eigen::MatrixXd ux_at_once = ux;
    all = Eigen::VectorXd::Zero(n);
    for (const std::size_t i : order) {
      const core::Trajectory& d = demonstrations[i];
      const Eigen::Index steps = d.controls.rows();
      const Eigen::MatrixXd u = d.controls;
      const Eigen::MatrixXd dx = d.states.bottomRows(steps) - d.states.topRows(steps);
      uu += u.transpose() * u;
      ux += u.transpose() * dx;
      all += dx.colwise().squaredNorm();
      if (steps < 2) continue;
      const Eigen::MatrixXd du = u.bottomRows(steps - 1) - u.topRows(steps - 1);
      const Eigen::MatrixXd ddx = dx.bottomRows(steps - 1) - dx.topRows(steps - 1);
      uu_at_once += du.transpose() * du;
      ux_at_once += du.transpose() * ddx;
    }
    const Eigen::MatrixXd inverse = core::PseudoInverse(uu);
    inverse_diagonal = inverse.diagonal();
    lasting = inverse * ux;
    left = all - ux.cwiseProduct(lasting).colwise().sum().transpose();
    at_once = core::PseudoInverse(uu_at_once) * ux_at_once;
  }

  // Returns true if entry `i` of the action is a velocity or an increment: some entry of the state
  // moves in proportion to it, as much in the first step of a new value as in later ones. A gripper
  // that closes and then stays closed moves in the first steps only. An entry that moves only while
  // the gripper is closed does not change at once with the gripper's value.
  [[nodiscard]] bool Moves(Eigen::Index i) const {
    if (!(inverse_diagonal[i] > 0.0)) return false;
    for (Eigen::Index k = 0; k < lasting.cols(); ++k) {
      const double explained = lasting(i, k) * lasting(i, k) / inverse_diagonal[i];
      const double ratio = at_once(i, k) / lasting(i, k);
      if (explained > fit::kLeastMoved * all[k] &&
          explained > fit::kProportional * (explained + std::max(0.0, left[k])) &&
          ratio >= 1.0 / fit::kSameEffect && ratio <= fit::kSameEffect) {
        return true;
      }
    }
    return false;
  }

  Eigen::VectorXd inverse_diagonal;
  Eigen::MatrixXd lasting;  // One row per entry of the action.
  Eigen::MatrixXd at_once;
  Eigen::VectorXd all;   // Squared changes.
  Eigen::VectorXd left;  // Squared changes that actions leave unexplained.
};

}  // namespace

ActionSpace::ActionSpace(std::span<const core::Trajectory> demonstrations,
                         std::vector<std::size_t> order) {
  DFR_THROW_UNLESS(!demonstrations.empty(), "there are no demonstrations");
  const Eigen::Index dim = demonstrations[0].controls.cols();
  entries_.resize(static_cast<std::size_t>(dim));
  // The order of the sum must not depend on the order of the demonstrations.
  if (order.empty()) order = core::DeterministicOrder(demonstrations);
  double moving = 0.0;
  std::vector<double> squares(entries_.size(), 0.0);
  std::vector<control::FewValues> values(entries_.size());
  for (const std::size_t d : order) {
    const core::Trajectory& demonstration = demonstrations[d];
    for (Eigen::Index t = 0; t < demonstration.controls.rows(); ++t) {
      const auto u = demonstration.controls.row(t);
      moving += u.squaredNorm() > 0.0 ? 1.0 : 0.0;
      for (std::size_t i = 0; i < entries_.size(); ++i) {
        const double value = u[static_cast<Eigen::Index>(i)];
        squares[i] += value * value;
        values[i].Add(value);
        entries_[i].largest = std::max(entries_[i].largest, std::abs(value));
      }
    }
  }
  const auto moves = [&](std::size_t i) { return squares[i] > 0.0; };
  DFR_THROW_UNLESS(moving > 0.0, "all actions of all "
                                     << demonstrations.size()
                                     << " demonstrations are zero: record the velocities or "
                                        "increments that moved the robot");
  std::optional<LinearResponse> response;
  for (std::size_t i = 0; i < entries_.size(); ++i) {
    entries_[i].steered = moves(i);
    if (!moves(i) || values[i].values().empty()) continue;
    if (!response) response.emplace(demonstrations, order);
    entries_[i].steered = response->Moves(static_cast<Eigen::Index>(i));
  }
  // If no entry is steered, steers all entries that demonstrations use.
  const bool none = SteeredOf(entries_).empty();
  for (std::size_t i = 0; i < entries_.size() && none; ++i) entries_[i].steered = moves(i);
  steered_ = SteeredOf(entries_);
  for (const int i : steered_) {
    const auto k = static_cast<std::size_t>(i);
    entries_[k].unit = std::sqrt(squares[k] / moving * static_cast<double>(steered_.size()));
  }
}

void ActionSpace::Save(core::ArchiveWriter& archive) const {
  archive.Integer(dim());
  for (const ActionEntry& entry : entries_) {
    archive.Integer(entry.steered ? 1 : 0);
    archive.Number(entry.largest);
    archive.Number(entry.unit);
  }
}

ActionSpace ActionSpace::Load(core::ArchiveReader& archive) {
  ActionSpace space;
  space.entries_.resize(static_cast<std::size_t>(archive.IntegerIn(1, kMostEntries)));
  for (ActionEntry& entry : space.entries_) {
    entry.steered = archive.IntegerIn(0, 1) == 1;
    entry.largest = archive.Number();
    entry.unit = archive.Number();
    if (!(entry.largest >= 0.0 && std::isfinite(entry.largest) && entry.unit > 0.0 &&
          std::isfinite(entry.unit))) {
      archive.Fail(
          "the range of an action entry must not be negative, and its unit must be positive");
    }
  }
  space.steered_ = SteeredOf(space.entries_);
  if (space.steered_.empty()) archive.Fail("no entry of an action is steered");
  return space;
}

std::vector<double> ActionSpace::Limits(double factor) const {
  std::vector<double> limits;
  limits.reserve(entries_.size());
  for (const ActionEntry& entry : entries_) limits.push_back(factor * entry.largest);
  return limits;
}

std::vector<double> ActionSpace::MeasuredLimits(std::span<const double> limits) const {
  std::vector<double> measured(steered_.size());
  Measure(limits, measured);
  return measured;
}

std::vector<core::Trajectory> ActionSpace::Measured(
    std::span<const core::Trajectory> demonstrations) const {
  std::vector<core::Trajectory> measured(demonstrations.begin(), demonstrations.end());
  for (core::Trajectory& demonstration : measured) {
    core::Matrix a(demonstration.controls.rows(), steered_dim());
    for (Eigen::Index t = 0; t < a.rows(); ++t) {
      Measure({demonstration.controls.row(t).data(), entries_.size()},
              {a.row(t).data(), steered_.size()});
    }
    demonstration.controls = std::move(a);
  }
  return measured;
}

std::string Join(std::span<const double> values) {
  std::string joined;
  for (const double value : values) {
    joined += (joined.empty() ? "" : ", ") + core::Format("%g", value);
  }
  return joined;
}

void ActionSpace::Measure(std::span<const double> u, std::span<double> a) const noexcept {
  for (std::size_t k = 0; k < steered_.size(); ++k) {
    const auto i = static_cast<std::size_t>(steered_[k]);
    a[k] = u[i] / entries_[i].unit;
  }
}

void ActionSpace::Restore(std::span<const double> a, std::span<double> u) const noexcept {
  for (std::size_t k = 0; k < steered_.size(); ++k) {
    const auto i = static_cast<std::size_t>(steered_[k]);
    u[i] = a[k] * entries_[i].unit;
  }
}

double ActionSpace::Distance(std::span<const double> u,
                             std::span<const double> other) const noexcept {
  double square = 0.0;
  for (const int k : steered_) {
    const auto i = static_cast<std::size_t>(k);
    const double difference = (u[i] - other[i]) / entries_[i].unit;
    square += difference * difference;
  }
  return std::sqrt(square);
}

double ActionSpace::StepOf(std::span<const double> u) const noexcept {
  double square = 0.0;
  for (const int k : steered_) {
    const auto i = static_cast<std::size_t>(k);
    square += u[i] / entries_[i].unit * (u[i] / entries_[i].unit);
  }
  return std::min(1.0, std::sqrt(square));
}

}  // namespace dfr::safety
