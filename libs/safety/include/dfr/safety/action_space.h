#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/archive.h"
#include "dfr/core/trajectory.h"

namespace dfr::safety {

/// What demonstrations show of one entry of an action.
struct ActionEntry {
  double largest = 0.0;  ///< Largest demonstrated |u_i|.
  /// Whether a guard may choose values of its own. An entry with few demonstrated values, such as a
  /// gripper that opens or closes, is not steered: the policy's value passes, within the limit.
  /// Where no other entry moves, those that do are steered all the same.
  bool steered = true;
  /// Size of an ordinary value: the root mean square of the demonstrated ones, times the square
  /// root of the number of steered entries, so that an ordinary action has |a| = 1 whatever its
  /// units.
  double unit = 1.0;
};

/// Measures each entry of an action u in a unit of its own: a_i = u_i / unit_i of the steered
/// entries. Guided recovery sees nothing but a, so that metres, radians and a gripper of +-1 may
/// stand side by side. Immutable.
class ActionSpace {
 public:
  /// @throws std::invalid_argument if no demonstrated action differs from zero.
  explicit ActionSpace(std::span<const core::Trajectory> demonstrations);
  void Save(core::ArchiveWriter& archive) const;
  /// @throws std::runtime_error naming the file and what is wrong with it.
  static ActionSpace Load(core::ArchiveReader& archive);

  /// Entries of u.
  [[nodiscard]] int dim() const noexcept { return static_cast<int>(entries_.size()); }
  /// Entries of a.
  [[nodiscard]] int steered_dim() const noexcept { return static_cast<int>(steered_.size()); }
  [[nodiscard]] const std::vector<ActionEntry>& entries() const noexcept { return entries_; }

  /// `factor` times the largest demonstrated |u_i| of each entry.
  [[nodiscard]] std::vector<double> Limits(double factor) const;
  /// Limits of a, one a steered entry, from those of u.
  [[nodiscard]] std::vector<double> MeasuredLimits(std::span<const double> limits) const;
  /// The demonstrations with a in place of u.
  [[nodiscard]] std::vector<core::Trajectory> Measured(
      std::span<const core::Trajectory> demonstrations) const;

  /// a of u. Neither allocates nor throws, as all that follow.
  void Measure(std::span<const double> u, std::span<double> a) const noexcept;
  /// Writes the steered entries of u.
  void Restore(std::span<const double> a, std::span<double> u) const noexcept;
  /// |a - b| of two actions.
  [[nodiscard]] double Distance(std::span<const double> u,
                                std::span<const double> other) const noexcept;

 private:
  ActionSpace() = default;

  std::vector<ActionEntry> entries_;
  std::vector<int> steered_;
};

/// "0.02, 0.02, 1" for people.
[[nodiscard]] std::string Join(std::span<const double> values);

}  // namespace dfr::safety
