#pragma once

#include <array>
#include <span>
#include <vector>

#include "dfr/core/files/archive.h"

namespace dfr::core {

/// Makes rotations in a state continuous. The unit quaternions q and -q are the same orientation;
/// the map selects the one in the hemisphere of a reference, and normalises it if its length is
/// within kMostLengthError of 1. Values of an angle may differ by a whole number of periods; the
/// map selects the one nearest to a centre. States of the same pose map to the same state (angles
/// and lengths up to rounding), and a mapped state maps to itself. All other entries stay
/// unchanged. For an angle with full revolutions, FeatureSelection uses two features.
///
/// Immutable. No call allocates or throws unless documented.
class StateMap {
 public:
  /// Largest error of a quaternion's length. Sensors cause smaller errors.
  static constexpr double kMostLengthError = 0.1;

  struct Quaternion {
    int first = 0;  ///< Index of the first of the four entries.
    std::array<double, 4> reference = {};
  };
  struct Angle {
    int entry = 0;
    double centre = 0.0;
    double period = 0.0;
  };
  /// An angle with full revolutions. Its features are r cos and r sin of the angle with r = period
  /// / (2 pi), which preserves small distances.
  struct Circle {
    int entry = 0;
    double period = 0.0;
    [[nodiscard]] std::array<double, 2> Point(double angle) const noexcept;
    /// Returns the derivative of Point().
    [[nodiscard]] std::array<double, 2> Tangent(double angle) const noexcept;
  };

  /// Creates the identity map.
  StateMap() = default;
  /// @throws std::invalid_argument if an entry is negative, a reference is not a unit quaternion, a
  ///   centre is not finite, a period is not positive and finite, or two rotations share an entry.
  StateMap(std::vector<Quaternion> quaternions, std::vector<Angle> angles,
           std::vector<Circle> circles = {});
  /// Appends the map to a file.
  void Save(ArchiveWriter& archive) const;
  /// Reads the data of Save() for states of `state_dim` entries.
  /// @throws std::runtime_error naming the file and the problem.
  static StateMap Load(ArchiveReader& archive, int state_dim);

  [[nodiscard]] bool empty() const noexcept {
    return quaternions_.empty() && angles_.empty() && circles_.empty();
  }
  [[nodiscard]] const std::vector<Quaternion>& quaternions() const noexcept { return quaternions_; }
  [[nodiscard]] const std::vector<Angle>& angles() const noexcept { return angles_; }
  [[nodiscard]] const std::vector<Circle>& circles() const noexcept { return circles_; }
  /// Returns the circle of an entry; null if it has none.
  [[nodiscard]] const Circle* FindCircle(int entry) const noexcept;
  /// Returns the minimum number of entries of a state that this map accepts.
  [[nodiscard]] int least_state_dim() const noexcept;

  /// Returns the mapped value of one entry.
  [[nodiscard]] double Value(std::span<const double> state, int entry) const noexcept;
  /// Returns the derivative of Value() with respect to the entry: 1, or for an entry of a
  /// quaternion 1 or -1 divided by the quaternion's length. Neglects the derivative of this length,
  /// because rotations do not change it.
  [[nodiscard]] double Slope(std::span<const double> state, int entry) const noexcept;
  /// Maps a state in place.
  void Apply(std::span<double> state) const noexcept;
  /// Returns the first entry of a quaternion whose length differs from 1 by more than
  /// kMostLengthError; -1 if there is none.
  [[nodiscard]] int FindInvalid(std::span<const double> state) const noexcept;

 private:
  std::vector<Quaternion> quaternions_;
  std::vector<Angle> angles_;
  std::vector<Circle> circles_;
};

}  // namespace dfr::core
