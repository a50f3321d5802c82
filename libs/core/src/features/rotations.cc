#include "dfr/core/features/rotations.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "dfr/core/features/absolute_actions.h"
#include "dfr/core/numerics/folds.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/text/format.h"

namespace dfr::core {
namespace {

using Kind = Rotation::Kind;

constexpr double kTolerance = 1e-3;
// Largest deviations from length 1 of quaternions rounded to two and to three decimal places.
constexpr double kTwoDigits = 0.015;
constexpr double kThreeDigits = 2e-3;
constexpr double kPi = std::numbers::pi;
constexpr std::array<double, 2> kPeriods = {2.0 * kPi, 360.0};
constexpr int kParts = 128;
// Number of adjacent parts of the circle, an eighth of it, that a continuous angle leaves free.
constexpr int kLeastFree = kParts / 8;
// A motion by more than this share of a period in one step cannot be distinguished from a jump.
constexpr double kMostMotion = 0.25;
// cos(150 degrees / 2). Farther from the mean, a small rotation may change which of q and -q is
// nearer to it.
constexpr double kLeastAlong = 0.2588190451025207;
// cos(90 degrees / 2). Four entries are a quaternion if both signs occur and all their values are
// this close to their mean or its opposite.
constexpr double kBothSigns = 0.7071067811865476;
// Rotations at the starts of two episodes count as the same up to this distance, in radians.
constexpr double kSameBegin = 0.6;
// Jumps of three entries belong to a rotation vector if the squared error of this model is below
// this fraction of the squared error of an angle.
constexpr double kLessError = 0.5;
// Minima for episodes that start at one angle in different revolutions: their number, the range of
// their starts in revolutions, and the length of the mean of the starts as unit vectors. Entries
// that are lengths rarely reach these minima.
constexpr int kFewestEpisodes = 8;
constexpr double kLeastApart = 0.75;
constexpr double kSameAngle = 0.97;

// Calls visit(first, whole) for each run of `size` adjacent entries of a block. `whole` is true if
// the block has no other entries.
template <typename Visit>
void EachWindow(const StateLayout& layout, int size, const Visit& visit) {
  for (const auto& block : layout.blocks) {
    for (int first = block.offset; first + size <= block.offset + block.size; ++first) {
      visit(first, size == block.size);
    }
  }
}

bool IsOneHot(const Eigen::Vector4d& q) {
  return (q.array() * (q.array() - 1.0)).cwiseAbs().maxCoeff() <= kTolerance;
}

bool AllVary(const std::vector<Eigen::Vector4d>& seen) {
  Eigen::Vector4d low = seen[0];
  Eigen::Vector4d high = seen[0];
  for (const Eigen::Vector4d& q : seen) {
    // Both signs denote the same orientation.
    const Eigen::Vector4d near = q.dot(seen[0]) < 0.0 ? Eigen::Vector4d(-q) : q;
    low = low.cwiseMin(near);
    high = high.cwiseMax(near);
  }
  return (high - low).minCoeff() > kTolerance;
}

// Returns the number of entries that are nonzero in some state. A single nonzero entry may be a
// flag.
int NumLive(const std::vector<Eigen::Vector4d>& seen) {
  Eigen::Vector4d largest = Eigen::Vector4d::Zero();
  for (const Eigen::Vector4d& q : seen) largest = largest.cwiseMax(q.cwiseAbs());
  return static_cast<int>((largest.array() > kTolerance).count());
}

// Returns true if all orientations are near their mean and both signs occur.
bool HasBothSigns(const std::vector<Eigen::Vector4d>& seen, const Eigen::Vector4d& mean) {
  double low = 1.0;
  double high = -1.0;
  for (const Eigen::Vector4d& q : seen) {
    const double along = mean.dot(q);
    if (std::abs(along) < kBothSigns) return false;
    low = std::min(low, along);
    high = std::max(high, along);
  }
  return low < 0.0 && high > 0.0;
}

// Returns the vector of the same rotation about the opposite axis.
Eigen::Vector3d OtherVector(const Eigen::Vector3d& v) { return v - 2.0 * kPi * v.normalized(); }

Eigen::Vector3d ShortVector(const Eigen::Vector3d& v) {
  return v.norm() > kPi ? OtherVector(v) : v;
}

// Returns the orientation with the largest sum of squared dot products with all of `seen`. Its sign
// makes the first of its largest entries positive.
Eigen::Vector4d MeanOrientation(const std::vector<Eigen::Vector4d>& seen) {
  constexpr double kTie = 1e-6;
  Eigen::Matrix4d sum = Eigen::Matrix4d::Zero();
  for (const Eigen::Vector4d& q : seen) sum += q * q.transpose();
  Eigen::Vector4d mean = DecomposeSymmetric(sum).vectors.col(3).normalized();
  const double largest = mean.cwiseAbs().maxCoeff();
  for (const double entry : mean) {
    if (std::abs(entry) < largest - kTie) continue;
    if (entry < 0.0) mean = -mean;
    break;
  }
  return mean;
}

// Returns the length and the start of the longest run of free parts of a circle. The run may wrap
// around.
std::pair<int, int> LongestFree(const std::uint64_t (&occupied)[2]) {
  const auto taken = [&](int part) {
    const auto i = static_cast<unsigned>(part % kParts);
    return ((occupied[i / 64] >> (i % 64)) & 1U) != 0;
  };
  std::pair<int, int> longest{0, 0};
  for (int begin = 0; begin < kParts; ++begin) {
    if (taken(begin)) continue;
    int length = 0;
    while (length < kParts && !taken(begin + length)) ++length;
    longest = std::max(longest, {length, begin},
                       [](const auto& a, const auto& b) { return a.first < b.first; });
  }
  return longest;
}

}  // namespace

RotationFinder::RotationFinder(const StateLayout& layout)
    : layout_(layout), circles_(static_cast<std::size_t>(layout.state_dim())) {
  EachWindow(layout, 4, [&](int first, bool whole) {
    fours_.push_back({.first = first, .whole = whole, .seen = {}});
  });
  EachWindow(layout, 9, [&](int first, bool) { nines_.push_back(first); });
  EachWindow(layout, 3, [&](int first, bool) { threes_.push_back({.first = first}); });
}

void RotationFinder::Add(const Matrix& states) {
  if (states.rows() == 0) return;
  AddFour(states);
  AddNine(states);
  AddThree(states);
  AddAngles(states);
  ++episodes_;
}

void RotationFinder::AddFour(const Matrix& states) {
  std::erase_if(fours_, [&](Four& four) {
    const auto rows = states.middleCols(four.first, 4);
    four.error = std::max(four.error, (rows.rowwise().norm().array() - 1.0).cwiseAbs().maxCoeff());
    if (four.error > (four.whole ? StateMap::kMostLengthError : kTwoDigits)) return true;
    for (Eigen::Index t = 0; t < rows.rows(); ++t) {
      const Eigen::Vector4d q = rows.row(t).normalized();
      four.flips = four.flips || (t > 0 && four.seen.back().dot(q) < 0.0);
      four.one_hot = four.one_hot && IsOneHot(q);
      four.seen.push_back(q);
    }
    return false;
  });
}

void RotationFinder::AddNine(const Matrix& states) {
  std::erase_if(nines_, [&](int first) {
    for (Eigen::Index t = 0; t < states.rows(); ++t) {
      const Eigen::Vector<double, 9> entries = states.row(t).segment(first, 9);
      const Eigen::Map<const Eigen::Matrix3d> r(entries.data());
      const Eigen::Matrix3d off = r.transpose() * r - Eigen::Matrix3d::Identity();
      if (off.cwiseAbs().maxCoeff() > kTolerance || r.determinant() < 0.0) return true;
    }
    return false;
  });
}

// At pi, v turns into v - 2 pi v / |v|. A vector computed from a quaternion with changing sign
// jumps at any angle and has a length of up to 2 pi.
void RotationFinder::AddThree(const Matrix& states) {
  std::erase_if(threes_, [&](Three& three) {
    const auto rows = states.middleCols(three.first, 3);
    if (rows.rowwise().norm().maxCoeff() > 2.0 * kPi + kTolerance) return true;
    for (Eigen::Index t = 0; t + 1 < rows.rows(); ++t) {
      const Eigen::Vector3d v = rows.row(t);
      const Eigen::Vector3d next = rows.row(t + 1);
      if ((next - v).norm() <= kPi) continue;
      const double missed = (next - OtherVector(v)).norm();
      if (missed > kMostMotion * kPeriods[0]) return true;
      three.jumps = true;
      three.as_vector += missed * missed;
      Eigen::Vector3d moved = next - v;
      Eigen::Index most = 0;
      moved.cwiseAbs().maxCoeff(&most);
      moved[most] = std::abs(moved[most]) - kPeriods[0];
      three.as_angle += moved.squaredNorm();
    }
    const Eigen::Vector3d begin = rows.row(0);
    if (episodes_ == 0) three.begin = begin;
    const double apart = std::min((ShortVector(begin) - ShortVector(three.begin)).norm(),
                                  (begin - OtherVector(three.begin)).norm());
    if ((begin - three.begin).norm() > kPi && apart <= kSameBegin) three.jumps = true;
    return false;
  });
}

void RotationFinder::AddAngles(const Matrix& states) {
  for (std::size_t k = 0; k < circles_.size(); ++k) {
    const auto column = states.col(static_cast<Eigen::Index>(k));
    for (std::size_t i = 0; i < kPeriods.size(); ++i) {
      Circle& circle = circles_[k][i];
      const double period = kPeriods[i];
      const bool empty = episodes_ == 0;
      circle.low = empty ? column.minCoeff() : std::min(circle.low, column.minCoeff());
      circle.high = empty ? column.maxCoeff() : std::max(circle.high, column.maxCoeff());
      circle.first_low = empty ? column[0] : std::min(circle.first_low, column[0]);
      circle.first_high = empty ? column[0] : std::max(circle.first_high, column[0]);
      circle.cosines += std::cos(2.0 * kPi * column[0] / period);
      circle.sines += std::sin(2.0 * kPi * column[0] / period);
      for (Eigen::Index t = 0; t < column.size(); ++t) {
        const double turns = column[t] / period;
        const auto part =
            static_cast<unsigned>(kParts * (turns - std::floor(turns))) % unsigned{kParts};
        circle.occupied[part / 64] |= std::uint64_t{1} << (part % 64);
        if (t == 0) continue;
        const double moved = (column[t] - column[t - 1]) / period;
        const double jumped = std::round(moved);
        circle.possible = circle.possible && std::abs(moved - jumped) <= kMostMotion;
        circle.jumps = circle.jumps || std::abs(jumped) >= 0.5;
      }
    }
  }
}

std::vector<Rotation> RotationFinder::Find() const {
  std::vector<Rotation> found;
  std::vector<bool> taken(static_cast<std::size_t>(layout_.state_dim()), episodes_ == 0);
  const auto take = [&](Rotation rotation) {
    const auto begin = taken.begin() + rotation.first;
    if (std::any_of(begin, begin + rotation.size, [](bool t) { return t; })) return;
    std::fill(begin, begin + rotation.size, true);
    found.push_back(rotation);
  };
  for (const int first : nines_) take({.kind = Kind::kMatrix, .first = first, .size = 9});
  for (const Four& four : fours_) {
    if (four.seen.empty() || (four.one_hot && !four.flips)) continue;
    const Eigen::Vector4d mean = MeanOrientation(four.seen);
    const int live = NumLive(four.seen);
    const bool both_signs = four.flips || HasBothSigns(four.seen, mean);
    const bool flag = !four.whole && live == 1;
    if (four.error > kTwoDigits && !both_signs) continue;
    if (!four.whole && !both_signs && (four.error > kThreeDigits || !AllVary(four.seen))) continue;
    const bool near = std::all_of(four.seen.begin(), four.seen.end(), [&](const auto& q) {
      return std::abs(mean.dot(q)) >= kLeastAlong;
    });
    take({.kind = Kind::kQuaternion,
          .first = four.first,
          .size = 4,
          .jumps = four.flips,
          .guessed = flag || (!four.whole && !four.flips && live == 2),
          .continuous = near && !flag,
          .reference = {mean[0], mean[1], mean[2], mean[3]}});
  }
  // Rotation vectors whose jumps move several entries take precedence over angles. A rotation about
  // one coordinate axis is better described as an angle.
  for (const Three& three : threes_) {
    if (!three.jumps || three.as_vector >= kLessError * three.as_angle) continue;
    take({.kind = Kind::kAxisAngle, .first = three.first, .size = 3, .jumps = true});
  }
  for (std::size_t k = 0; k < circles_.size(); ++k) {
    for (std::size_t i = 0; i < kPeriods.size(); ++i) {
      const Circle& circle = circles_[k][i];
      const double period = kPeriods[i];
      const double slack = kTolerance * period;
      const bool centred =
          circle.low >= -0.5 * period - slack && circle.high <= 0.5 * period + slack;
      const bool positive = circle.low >= -slack && circle.high <= period + slack;
      if (!circle.jumps || !circle.possible || !(centred || positive)) continue;
      const auto [length, begin] = LongestFree(circle.occupied);
      const double free = (begin + 0.5 * length) / kParts;  // Middle of the run, in revolutions.
      take({.kind = Kind::kAngle,
            .first = static_cast<int>(k),
            .size = 1,
            .period = period,
            .jumps = true,
            .continuous = length >= kLeastFree,
            .centre = period * (free < 0.5 ? free + 0.5 : free - 0.5)});
    }
  }
  for (std::size_t k = 0; k < circles_.size(); ++k) {
    for (std::size_t i = 0; i < kPeriods.size(); ++i) {
      const Circle& circle = circles_[k][i];
      if (episodes_ < kFewestEpisodes || !circle.possible ||
          circle.first_high - circle.first_low < kLeastApart * kPeriods[i] ||
          std::hypot(circle.cosines, circle.sines) < kSameAngle * episodes_) {
        continue;
      }
      take(
          {.kind = Kind::kRunning, .first = static_cast<int>(k), .size = 1, .period = kPeriods[i]});
    }
  }
  for (const Three& three : threes_) {
    if (!three.jumps) continue;
    take({.kind = Kind::kAxisAngle, .first = three.first, .size = 3, .jumps = true});
  }
  std::sort(found.begin(), found.end(),
            [](const Rotation& a, const Rotation& b) { return a.first < b.first; });
  return found;
}

std::vector<Rotation> FindRotations(const StateLayout& layout,
                                    std::span<const Trajectory> demonstrations) {
  RotationFinder finder(layout);
  for (const std::size_t d : DeterministicOrder(demonstrations))
    finder.Add(demonstrations[d].states);
  return finder.Find();
}

void RemoveJumps(std::span<const Rotation> rotations, Matrix& states) {
  for (const Rotation& r : rotations) {
    if (r.kind == Kind::kAngle) {
      auto angle = states.col(r.first);
      double turned = 0.0;
      for (Eigen::Index t = 1; t < angle.size(); ++t) {
        turned += r.period * std::round((angle[t - 1] - angle[t] - turned) / r.period);
        angle[t] += turned;
      }
    }
    if (r.kind == Kind::kQuaternion) {
      auto q = states.middleCols(r.first, r.size);
      for (Eigen::Index t = 1; t < q.rows(); ++t) {
        if (q.row(t).dot(q.row(t - 1)) < 0.0) q.row(t) *= -1.0;
      }
    }
  }
}

StateMap MapOf(std::span<const Rotation> rotations) {
  std::vector<StateMap::Quaternion> quaternions;
  std::vector<StateMap::Angle> angles;
  std::vector<StateMap::Circle> circles;
  for (const Rotation& r : rotations) {
    if (r.kind == Kind::kQuaternion && r.continuous) quaternions.push_back({r.first, r.reference});
    if (r.kind != Kind::kAngle) continue;
    if (r.continuous) {
      angles.push_back({r.first, r.centre, r.period});
    } else {
      circles.push_back({r.first, r.period});
    }
  }
  return {std::move(quaternions), std::move(angles), std::move(circles)};
}

std::string EntryRange(const StateLayout& layout, int first, int size) {
  const auto block = std::find_if(layout.blocks.begin(), layout.blocks.end(),
                                  [&](const auto& b) { return first < b.offset + b.size; });
  return block->name + Format("[%d:%d]", first - block->offset, first - block->offset + size);
}

std::string Describe(const Rotation& rotation, const StateLayout& layout) {
  std::string name = rotation.size == 1 ? EntryName(layout, rotation.first)
                                        : EntryRange(layout, rotation.first, rotation.size);
  switch (rotation.kind) {
    case Kind::kQuaternion:
      if (rotation.guessed && !rotation.continuous) {
        return name +
               " has only one nonzero entry: it is a flag of +-1, or a unit quaternion that never "
               "turns but changes its sign. Both signs remain separate states. Use the same sign "
               "of a quaternion everywhere, or give it a block of four entries in the layout";
      }
      if (rotation.guessed) {
        return name +
               " is treated as a unit quaternion about a fixed axis, because its sign differs "
               "between demonstrations: q and -q are one state. If they are not, give each of "
               "these entries a separate block in the layout";
      }
      if (rotation.continuous) {
        return name + " is a unit quaternion: a guard treats q and -q as the same orientation";
      }
      return name +
             " is a unit quaternion with orientations more than 150 degrees from their mean: "
             "q and -q remain two states. Use the first two columns of the rotation matrix instead";
    case Kind::kAngle:
      if (rotation.continuous) {
        return name + Format(" is an angle that jumps by %g: a guard uses the value nearest to %g",
                             rotation.period, rotation.centre);
      }
      return name + Format(
                        " is an angle that jumps by %g and makes full turns: a guard uses its "
                        "cosine and sine. If the revolution matters, use the unwrapped angle "
                        "instead",
                        rotation.period);
    case Kind::kMatrix:
      return name +
             " is a rotation matrix: it is continuous, but redundant. Six of its entries, two rows "
             "or two columns, are enough";
    case Kind::kAxisAngle:
      return name +
             " is a rotation vector (axis times angle) that jumps by 2 pi along its axis. Use the "
             "first two columns of the rotation matrix instead";
    case Kind::kRunning:
      return name + Format(
                        " is an unwrapped angle: episodes begin at angles that differ by "
                        "multiples of %g, and the same orientation is another state in each "
                        "revolution. Use its cosine and sine instead, or let each episode begin in "
                        "the same revolution",
                        rotation.period);
  }
  return name;
}

}  // namespace dfr::core
