#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/features/features.h"
#include "dfr/core/features/state_map.h"
#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"

namespace dfr::core {

/// Entries of a state that represent a rotation.
struct Rotation {
  enum class Kind {
    kQuaternion,  ///< 4 entries; q and -q are the same orientation.
    kAngle,       ///< 1 entry that jumps by a period, 2 pi or 360.
    kMatrix,      ///< 9 entries; continuous and redundant.
    kAxisAngle,   ///< 3 entries, axis times angle; jumps at pi, or if its quaternion changes sign.
    kRunning,     ///< 1 entry, unwrapped; episodes begin at one angle in different revolutions.
  };
  Kind kind = Kind::kAngle;
  int first = 0;
  int size = 1;
  double period = 0.0;  ///< Period of kAngle and kRunning.
  /// True if the entries jump between consecutive states. For kAxisAngle, also if they jump between
  /// starts of demonstrations.
  bool jumps = false;
  /// For kQuaternion: true if at least two of its entries are always zero, and only the sign
  /// indicates a quaternion.
  bool guessed = false;
  /// True if all values lie in one branch: all quaternions are within 150 degrees of `reference`,
  /// or no value of an angle is in the eighth of the period opposite `centre`.
  bool continuous = false;
  std::array<double, 4> reference = {};  ///< Mean orientation of a kQuaternion.
  double centre = 0.0;                   ///< Middle of the branch of a kAngle.

  /// Returns true if MapOf() makes the rotation continuous: by selecting a branch or, for an angle,
  /// by using its cosine and sine.
  [[nodiscard]] bool mapped() const noexcept { return continuous || kind == Kind::kAngle; }
};

/// Finds rotations in states, one episode at a time.
///
/// Tolerances: a matrix is orthonormal within 1e-3 in all states. A block of four entries is a
/// quaternion if its length is 1 within 0.015, which allows for rounding to two decimal places, or
/// within StateMap::kMostLengthError if it changes sign between states or episodes. Four entries of
/// a larger block are a quaternion only if they change sign together, between states or between
/// episodes, or if all of them vary and the length is 1 within 0.002. Within an episode, a running
/// angle without a jump cannot be distinguished from a length. It is found if at least 8 episodes
/// begin a whole number of periods apart. Memory grows with the number of states only for
/// quaternions.
class RotationFinder {
 public:
  explicit RotationFinder(const StateLayout& layout);
  /// Adds an episode: states (T + 1) x state_dim, all finite.
  void Add(const Matrix& states);
  /// Returns the rotations in the order of their entries. The order of the episodes affects the
  /// rounding of a reference.
  [[nodiscard]] std::vector<Rotation> Find() const;

 private:
  // Statistics of four adjacent entries of one block.
  struct Four {
    int first = 0;
    bool whole = false;  // True if these are all entries of the block.
    bool flips = false;
    bool one_hot = true;
    double error = 0.0;  // Largest deviation of the length from 1.
    std::vector<Eigen::Vector4d> seen;
  };
  struct Three {
    int first = 0;
    bool jumps = false;
    Eigen::Vector3d begin = Eigen::Vector3d::Zero();  // First state of the first episode.
    // Squared errors of two models of the jumps: a rotation vector, and an angle in one entry.
    double as_vector = 0.0;
    double as_angle = 0.0;
  };
  // Statistics of one entry, interpreted as an angle with this period.
  struct Circle {
    double low = 0.0;
    double high = 0.0;
    bool jumps = false;
    // True if consecutive states are always close enough for an angle.
    bool possible = true;
    std::uint64_t occupied[2] = {};  // One bit per 128th of the circle, 1 if occupied.
    // Range of the angles at which episodes begin, and sums of their cosines and sines.
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
  std::vector<std::array<Circle, 2>> circles_;  // Per entry: in radians, then in degrees.
};

/// Finds the rotations in a set of demonstrations. Their order does not affect the result.
[[nodiscard]] std::vector<Rotation> FindRotations(const StateLayout& layout,
                                                  std::span<const Trajectory> demonstrations);

/// Removes the jumps of angles and quaternions between consecutive rows of one episode, in time
/// order: an angle counts its revolutions, and a quaternion keeps its sign. Rows before the first
/// jump stay unchanged.
void RemoveJumps(std::span<const Rotation> rotations, Matrix& states);

/// Returns the map that makes these rotations continuous.
[[nodiscard]] StateMap MapOf(std::span<const Rotation> rotations);

/// Returns the notation for adjacent entries of one block, for example "object[2:6]".
[[nodiscard]] std::string EntryRange(const StateLayout& layout, int first, int size);

/// Describes the rotation in one or two sentences for a warning or a report, with the remedy if one
/// is needed.
[[nodiscard]] std::string Describe(const Rotation& rotation, const StateLayout& layout);

}  // namespace dfr::core
