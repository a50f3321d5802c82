#include "dfr/core/features/state_map.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <utility>

#include "dfr/core/contract.h"

namespace dfr::core {
namespace {

constexpr int kSize = 4;
// Largest error of the length of a normalised quaternion, also in single precision.
constexpr double kRounding = 1e-6;
constexpr int kMostEntries = 1 << 16;

template <typename Values>
double Dot(const Values& a, std::span<const double> b) noexcept {
  double sum = 0.0;
  for (std::size_t k = 0; k < static_cast<std::size_t>(kSize); ++k) sum += a[k] * b[k];
  return sum;
}

std::span<const double> Of(std::span<const double> state, const StateMap::Quaternion& q) noexcept {
  return state.subspan(static_cast<std::size_t>(q.first), static_cast<std::size_t>(kSize));
}

double LengthError(std::span<const double> entries) noexcept {
  return std::sqrt(Dot(entries, entries)) - 1.0;
}

// Returns the factor that moves the quaternion into the hemisphere of the reference and normalises
// it. Lengths that FindInvalid() rejects, and those that differ from 1 by rounding, stay unchanged.
double Factor(std::span<const double> state, const StateMap::Quaternion& q) noexcept {
  const std::span<const double> entries = Of(state, q);
  const double sign = Dot(q.reference, entries) < 0.0 ? -1.0 : 1.0;
  const double error = LengthError(entries);
  const bool off = std::abs(error) > kRounding && std::abs(error) <= StateMap::kMostLengthError;
  return off ? sign / (1.0 + error) : sign;
}

double Near(double value, const StateMap::Angle& angle) noexcept {
  return value - angle.period * std::round((value - angle.centre) / angle.period);
}

}  // namespace

std::array<double, 2> StateMap::Circle::Point(double angle) const noexcept {
  const double radius = period / (2.0 * std::numbers::pi);
  return {radius * std::cos(angle / radius), radius * std::sin(angle / radius)};
}

std::array<double, 2> StateMap::Circle::Tangent(double angle) const noexcept {
  const double radius = period / (2.0 * std::numbers::pi);
  return {-std::sin(angle / radius), std::cos(angle / radius)};
}

StateMap::StateMap(std::vector<Quaternion> quaternions, std::vector<Angle> angles,
                   std::vector<Circle> circles)
    : quaternions_(std::move(quaternions)),
      angles_(std::move(angles)),
      circles_(std::move(circles)) {
  for (const Quaternion& q : quaternions_) {
    DFR_THROW_UNLESS(q.first >= 0, "a quaternion cannot begin at entry " << q.first);
    const double error = LengthError(q.reference);
    DFR_THROW_UNLESS(
        std::abs(error) <= kRounding,
        "a reference orientation must be a unit quaternion, not one of length " << 1.0 + error);
  }
  for (const Angle& angle : angles_) {
    DFR_THROW_UNLESS(angle.entry >= 0, "an angle cannot be entry " << angle.entry);
    DFR_THROW_UNLESS(
        std::isfinite(angle.centre) && angle.period > 0.0 && std::isfinite(angle.period),
        "the centre of an angle must be finite, its period positive and finite: "
            << angle.centre << ", " << angle.period);
  }
  for (const Circle& circle : circles_) {
    DFR_THROW_UNLESS(circle.entry >= 0, "an angle cannot be entry " << circle.entry);
    DFR_THROW_UNLESS(circle.period > 0.0 && std::isfinite(circle.period),
                     "the period of an angle must be positive and finite: " << circle.period);
  }
  std::vector<int> entries;
  for (const Quaternion& q : quaternions_) {
    for (int k = 0; k < kSize; ++k) entries.push_back(q.first + k);
  }
  for (const Angle& angle : angles_) entries.push_back(angle.entry);
  for (const Circle& circle : circles_) entries.push_back(circle.entry);
  std::sort(entries.begin(), entries.end());
  const auto twice = std::adjacent_find(entries.begin(), entries.end());
  DFR_THROW_UNLESS(twice == entries.end(), "entry " << *twice << " belongs to two rotations");
}

void StateMap::Save(ArchiveWriter& archive) const {
  archive.Integer(std::ssize(quaternions_));
  for (const Quaternion& q : quaternions_) {
    archive.Integer(q.first);
    archive.Numbers(q.reference);
  }
  archive.Integer(std::ssize(angles_));
  for (const Angle& angle : angles_) {
    archive.Integer(angle.entry);
    archive.Number(angle.centre);
    archive.Number(angle.period);
  }
  archive.Integer(std::ssize(circles_));
  for (const Circle& circle : circles_) {
    archive.Integer(circle.entry);
    archive.Number(circle.period);
  }
}

StateMap StateMap::Load(ArchiveReader& archive, int state_dim) {
  std::vector<Quaternion> quaternions;
  const int num_quaternions = archive.IntegerIn(0, kMostEntries);
  for (int i = 0; i < num_quaternions; ++i) {
    const int first = archive.IntegerIn(0, std::max(0, state_dim - kSize));
    const std::vector<double> reference = archive.Numbers();
    if (reference.size() != kSize || state_dim < kSize) {
      archive.Fail("a quaternion needs 4 entries of the state");
    }
    quaternions.push_back({first, {reference[0], reference[1], reference[2], reference[3]}});
  }
  std::vector<Angle> angles;
  const int num_angles = archive.IntegerIn(0, kMostEntries);
  for (int i = 0; i < num_angles; ++i) {
    const int entry = archive.IntegerIn(0, state_dim - 1);
    const double centre = archive.Number();
    angles.push_back({entry, centre, archive.Number()});
  }
  std::vector<Circle> circles;
  const int num_circles = archive.IntegerIn(0, kMostEntries);
  for (int i = 0; i < num_circles; ++i) {
    const int entry = archive.IntegerIn(0, state_dim - 1);
    circles.push_back({entry, archive.Number()});
  }
  try {
    return {std::move(quaternions), std::move(angles), std::move(circles)};
  } catch (const std::invalid_argument& e) {
    archive.Fail(e.what());
  }
}

int StateMap::least_state_dim() const noexcept {
  int least = 0;
  for (const Quaternion& q : quaternions_) least = std::max(least, q.first + kSize);
  for (const Angle& angle : angles_) least = std::max(least, angle.entry + 1);
  for (const Circle& circle : circles_) least = std::max(least, circle.entry + 1);
  return least;
}

const StateMap::Circle* StateMap::FindCircle(int entry) const noexcept {
  const auto found = std::find_if(circles_.begin(), circles_.end(),
                                  [&](const Circle& circle) { return circle.entry == entry; });
  return found == circles_.end() ? nullptr : &*found;
}

double StateMap::Value(std::span<const double> state, int entry) const noexcept {
  const double value = state[static_cast<std::size_t>(entry)];
  for (const Angle& angle : angles_) {
    if (angle.entry == entry) return Near(value, angle);
  }
  return Slope(state, entry) * value;
}

double StateMap::Slope(std::span<const double> state, int entry) const noexcept {
  for (const Quaternion& q : quaternions_) {
    if (entry >= q.first && entry < q.first + kSize) return Factor(state, q);
  }
  return 1.0;
}

void StateMap::Apply(std::span<double> state) const noexcept {
  for (const Quaternion& q : quaternions_) {
    const double factor = Factor(state, q);
    for (int k = q.first; k < q.first + kSize; ++k) state[static_cast<std::size_t>(k)] *= factor;
  }
  for (const Angle& angle : angles_) {
    double& value = state[static_cast<std::size_t>(angle.entry)];
    value = Near(value, angle);
  }
}

int StateMap::FindInvalid(std::span<const double> state) const noexcept {
  for (const Quaternion& q : quaternions_) {
    if (!(std::abs(LengthError(Of(state, q))) <= kMostLengthError)) return q.first;
  }
  return -1;
}

}  // namespace dfr::core
