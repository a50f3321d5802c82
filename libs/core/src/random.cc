#include "dfr/core/random.h"

#include <bit>
#include <cmath>

namespace dfr::core {
namespace {

// SplitMix64 (Steele, Lea, Flood 2014): one step of the counter, then its finaliser.
std::uint64_t SplitMix(std::uint64_t& counter) noexcept {
  std::uint64_t z = (counter += 0x9e3779b97f4a7c15u);
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return z ^ (z >> 31);
}

}  // namespace

std::uint64_t DeriveSeed(std::uint64_t seed, std::initializer_list<std::uint64_t> path) noexcept {
  std::uint64_t counter = seed;
  std::uint64_t derived = SplitMix(counter);
  for (const std::uint64_t step : path) {
    // Hashes each step separately before mixing: {1, 2} and {2, 1} give different seeds.
    std::uint64_t step_counter = step;
    counter = derived ^ std::rotl(SplitMix(step_counter), 23);
    derived = SplitMix(counter);
  }
  return derived;
}

Random::Random(std::uint64_t seed) noexcept {
  for (std::uint64_t& word : state_) word = SplitMix(seed);
}

std::uint64_t Random::operator()() noexcept {
  const std::uint64_t result = std::rotl(state_[0] + state_[3], 23) + state_[0];
  const std::uint64_t t = state_[1] << 17;
  state_[2] ^= state_[0];
  state_[3] ^= state_[1];
  state_[1] ^= state_[2];
  state_[0] ^= state_[3];
  state_[2] ^= t;
  state_[3] = std::rotl(state_[3], 45);
  return result;
}

double Random::Uniform() noexcept { return static_cast<double>((*this)() >> 11) * 0x1.0p-53; }

double Random::Normal() noexcept {
  if (has_spare_normal_) {
    has_spare_normal_ = false;
    return spare_normal_;
  }
  double u = 0.0;
  double v = 0.0;
  double square = 0.0;
  do {
    u = Uniform(-1.0, 1.0);
    v = Uniform(-1.0, 1.0);
    square = u * u + v * v;
  } while (square >= 1.0 || square == 0.0);
  const double scale = std::sqrt(-2.0 * std::log(square) / square);
  spare_normal_ = v * scale;
  has_spare_normal_ = true;
  return u * scale;
}

std::uint64_t Random::Below(std::uint64_t n) noexcept {
  const std::uint64_t reject_below = (~n + 1) % n;  // 2^64 mod n
  std::uint64_t bits = 0;
  do bits = (*this)();
  while (bits < reject_below);
  return bits % n;
}

void Random::Direction(std::span<double> direction) noexcept {
  double norm_squared = 0.0;
  do {
    norm_squared = 0.0;
    for (double& entry : direction) {
      entry = Normal();
      norm_squared += entry * entry;
    }
  } while (norm_squared == 0.0);
  const double scale = 1.0 / std::sqrt(norm_squared);
  for (double& entry : direction) entry *= scale;
}

}  // namespace dfr::core
