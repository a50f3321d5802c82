#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/files/archive.h"
#include "dfr/core/trajectory.h"

namespace dfr::safety {

/// Demonstrated range and unit of one entry of an action.
struct ActionEntry {
  double largest = 0.0;  ///< Largest demonstrated |u_i|.
  /// True if a guard may change the entry. An entry with few demonstrated values, such as a gripper
  /// that opens or closes, is steered only in two cases: the state moves in proportion to the
  /// entry, as with an axis that moves at one speed or stands still, or no entry at all would be
  /// steered. In all other cases the policy's value passes, clamped to the limit.
  bool steered = true;
  /// Size of an ordinary value: the root mean square over demonstrated nonzero actions, times the
  /// square root of the number of steered entries. An ordinary action has |a| = 1 in any units.
  double unit = 1.0;
};

/// Scales the steered entries of an action u: a_i = u_i / unit_i. Guided recovery uses only a, so
/// an action may combine metres, radians and a gripper of +-1. Immutable.
class ActionSpace {
 public:
  /// Entries of states must not jump (core::RemoveJumps()): an axis with jumps would look like a
  /// gripper.
  /// @param order  the order of summation; empty: core::DeterministicOrder().
  /// @throws std::invalid_argument if all demonstrated actions are zero.
  explicit ActionSpace(std::span<const core::Trajectory> demonstrations,
                       std::vector<std::size_t> order = {});
  void Save(core::ArchiveWriter& archive) const;
  /// @throws std::runtime_error naming the file and its defect.
  static ActionSpace Load(core::ArchiveReader& archive);

  /// Returns the number of entries of u.
  [[nodiscard]] int dim() const noexcept { return static_cast<int>(entries_.size()); }
  /// Returns the number of entries of a.
  [[nodiscard]] int steered_dim() const noexcept { return static_cast<int>(steered_.size()); }
  [[nodiscard]] const std::vector<ActionEntry>& entries() const noexcept { return entries_; }

  /// Returns `factor` times the largest demonstrated |u_i| of each entry.
  [[nodiscard]] std::vector<double> Limits(double factor) const;
  /// Returns limits of a, one per steered entry, from `limits` of u.
  [[nodiscard]] std::vector<double> MeasuredLimits(std::span<const double> limits) const;
  /// Returns the demonstrations with each u replaced by its a.
  [[nodiscard]] std::vector<core::Trajectory> Measured(
      std::span<const core::Trajectory> demonstrations) const;

  /// Computes `a` from `u`. This function and all following ones neither allocate nor throw.
  void Measure(std::span<const double> u, std::span<double> a) const noexcept;
  /// Writes the steered entries of `u` from `a`.
  void Restore(std::span<const double> a, std::span<double> u) const noexcept;
  /// Returns |a - b|, where a and b are the scaled entries of the two actions.
  [[nodiscard]] double Distance(std::span<const double> u,
                                std::span<const double> other) const noexcept;
  /// Returns |a| of an action, at most 1: the fraction of an ordinary step.
  [[nodiscard]] double StepOf(std::span<const double> u) const noexcept;

 private:
  ActionSpace() = default;

  std::vector<ActionEntry> entries_;
  std::vector<int> steered_;
};

/// Formats values: "0.02, 0.02, 1".
[[nodiscard]] std::string Join(std::span<const double> values);

}  // namespace dfr::safety
