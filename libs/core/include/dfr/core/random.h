#pragma once

#include <array>
#include <cstdint>
#include <initializer_list>
#include <span>
#include <utility>

namespace dfr::core {

/// Returns the seed of an independent stream: DeriveSeed(seed, {trial, episode, purpose}). The same
/// arguments give the same result on every machine. Different paths give unrelated seeds, which
/// allows any number of threads and any order of the work.
[[nodiscard]] std::uint64_t DeriveSeed(std::uint64_t seed,
                                       std::initializer_list<std::uint64_t> path) noexcept;

/// Random number generator xoshiro256++ (Blackman and Vigna, 2019), seeded through SplitMix64.
///
/// This class alone defines the sequence: it is the same with every standard library, unlike the
/// distributions of the standard library. Never allocates, never throws. Each object belongs to one
/// thread.
class Random {
 public:
  using result_type = std::uint64_t;

  explicit Random(std::uint64_t seed) noexcept;

  /// Returns 64 uniform bits.
  std::uint64_t operator()() noexcept;
  static constexpr std::uint64_t min() noexcept { return 0; }
  static constexpr std::uint64_t max() noexcept { return ~std::uint64_t{0}; }

  /// Returns a uniform number in [0, 1), a multiple of 2^-53.
  double Uniform() noexcept;
  /// Returns a uniform number in [low, high).
  double Uniform(double low, double high) noexcept { return low + (high - low) * Uniform(); }
  /// Returns a normal number with mean 0 and variance 1 (Marsaglia's polar method).
  double Normal() noexcept;
  /// Returns a uniform integer in {0, ..., n - 1}, without modulo bias. @pre n > 0
  std::uint64_t Below(std::uint64_t n) noexcept;

  /// Fills `direction` with a uniformly distributed unit vector. @pre `direction` is not empty
  void Direction(std::span<double> direction) noexcept;

  /// Shuffles `items` (Fisher-Yates).
  template <typename T>
  void Shuffle(std::span<T> items) noexcept {
    for (std::size_t i = items.size(); i > 1; --i) std::swap(items[i - 1], items[Below(i)]);
  }

 private:
  std::array<std::uint64_t, 4> state_;
  double spare_normal_ = 0.0;
  bool has_spare_normal_ = false;
};

}  // namespace dfr::core
