#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/features.h"
#include "dfr/core/matrix.h"
#include "dfr/core/state_map.h"
#include "dfr/core/trajectory.h"

namespace dfr::core {

/// Entries of a state that hold a rotation.
struct Rotation {
  enum class Kind {
    kQuaternion,  ///< 4 entries; q and -q are the same orientation.
    kAngle,       ///< 1 entry that jumps by a period, 2 pi or 360.
    kMatrix,      ///< 9 entries; continuous and redundant.
    kAxisAngle,   ///< 3 entries whose length is an angle; jumps at pi, or at another sign of q.
    kRunning,     ///< 1 entry; episodes begin at one angle, but on several revolutions.
  };
  Kind kind = Kind::kAngle;
  int first = 0;
  int size = 1;
  double period = 0.0;  ///< For kAngle and kRunning.
  /// It jumps between consecutive states of a demonstration. For kAxisAngle also between
  /// demonstrations.
  bool jumps = false;
  /// For kQuaternion: two or more of its entries are always zero, and only the sign indicates a
  /// quaternion.
  bool guessed = false;
  /// One branch holds all values: all quaternions are within 150 degrees of `reference`; the values
  /// of an angle leave at least an eighth of the period free around its opposite.
  bool continuous = false;
  std::array<double, 4> reference = {};  ///< The mean orientation, for kQuaternion.
  double centre = 0.0;                   ///< For kAngle.

  /// Returns true if MapOf() makes it continuous: by one branch, or an angle by cosine and sine.
  [[nodiscard]] bool mapped() const noexcept { return continuous || kind == Kind::kAngle; }
};

/// Finds rotations in states, one episode at a time.
///
/// Tolerances: orthonormality is right within 1e-3 in all states. A block of four entries is a
/// quaternion if its length is 1 within 0.015, which two digits after the point keep; four entries
/// of a larger block only if they change sign together, between states or between episodes, or all
/// of them vary and the length is 1 within 0.002. An angle that runs on without a jump looks like a
/// length; it is found where 8 episodes or more begin a whole number of periods apart. Memory grows
/// with the number of states only where quaternions are.
class RotationFinder {
 public:
  explicit RotationFinder(const StateLayout& layout);
  /// States (T + 1) x state_dim, all finite.
  void Add(const Matrix& states);
  /// In the order of the entries. The order of the episodes changes the rounding of a reference.
  [[nodiscard]] std::vector<Rotation> Find() const;

 private:
  // Statistics of four adjacent entries of one block.
  struct Four {
    int first = 0;
    bool whole = false;  // All of the block.
    bool flips = false;
    bool one_hot = true;
    double error = 0.0;  // Largest error of the length.
    std::vector<Eigen::Vector4d> seen;
  };
  struct Three {
    int first = 0;
    bool jumps = false;
    Eigen::Vector3d begin = Eigen::Vector3d::Zero();  // First state of the first episode.
    // Squared errors of the jumps of a rotation vector, and of one angle beside two lengths.
    double as_vector = 0.0;
    double as_angle = 0.0;
  };
  // Statistics of one entry, as an angle with this period.
  struct Circle {
    double low = 0.0;
    double high = 0.0;
    bool jumps = false;
    bool possible = true;            // No two states are too far apart for an angle.
    std::uint64_t occupied[2] = {};  // Visited ones of 128 equal parts of the circle.
    // Angles at which episodes begin.
    double first_low = 0.0;
    double first_high = 0.0;
    double cosines = 0.0;
    double sines = 0.0;
  };

  void AddFour(const Matrix& states);
  void AddNine(const Matrix& states);
  void AddThree(const Matrix& states);
  void AddAngles(const Matrix& states);

  StateLayout layout_;
  int episodes_ = 0;
  std::vector<Four> fours_;
  std::vector<int> nines_;
  std::vector<Three> threes_;
  std::vector<std::array<Circle, 2>> circles_;  // Radians, degrees; one an entry.
};

/// Finds rotations in a whole set at once. The order of the demonstrations changes no bit.
[[nodiscard]] std::vector<Rotation> FindRotations(const StateLayout& layout,
                                                  std::span<const Trajectory> demonstrations);

/// Returns the map that makes these rotations continuous.
[[nodiscard]] StateMap MapOf(std::span<const Rotation> rotations);

/// "object[2:6]": adjacent entries of one block as users name them.
[[nodiscard]] std::string EntryRange(const StateLayout& layout, int first, int size);

/// Describes the rotation in one or two sentences for a warning or a report, with the remedy if one
/// is needed.
[[nodiscard]] std::string Describe(const Rotation& rotation, const StateLayout& layout);

}  // namespace dfr::core
