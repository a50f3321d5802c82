#pragma once

#include <bit>
#include <cmath>
#include <cstddef>
#include <type_traits>

#include "dfr/core/matrix.h"
#include "gaussian/gaussian_terms.h"

namespace dfr::kernel::internal {

/// Unit of the memory of a SumBlock. At low optimisation levels, std::vector loops even over
/// trivial elements. With bytes as the unit, these loops would take a tenth of the time of a small
/// fit.
struct alignas(64) CacheLine {
  std::byte bytes[64];
};

template <typename T>
struct SumBlock;

/// Functions of gaussian_sum.h that sum terms, for one instruction set.
template <typename T>
struct SumFunctions {
  T (*sum)(const SumBlock<T>&, const T* x) = nullptr;
  void (*sums)(const SumBlock<T>&, const T* x, std::size_t count, T* sums) = nullptr;
  T (*sum_shift)(const SumBlock<T>&, const T* x, T offset, T* shift) = nullptr;
  T (*largest)(const SumBlock<T>&, const T* x) = nullptr;
  std::size_t together = 1;  ///< Number of blocks of kLanes terms evaluated together.
};

/// Number of blocks in the next group of a sum if `left` blocks are left.
constexpr std::size_t GroupBlocks(std::size_t together, std::size_t left) {
  return std::bit_floor(left < together ? left : together);
}

/// Constants of 2^e: the coefficients of 2^f on [0, 1), the highest power first, the least exponent
/// of a normal number, and 1.5 * 2^(mantissa bits), which moves an integer into the low bits. They
/// are in a separate block of memory, which a decision can prefetch into a cold cache.
template <typename T>
struct alignas(64) Exp2Constants {
  static constexpr std::size_t kDegree = sizeof(T) == 4 ? 5 : 10;
  T coefficients[kDegree + 1];
  T least;
  T round;
};
// With hidden visibility, no table lookup is needed to find the address.
[[gnu::visibility("hidden")]] extern const Exp2Constants<double> kExp2Double;
[[gnu::visibility("hidden")]] extern const Exp2Constants<float> kExp2Float;
template <typename T>
[[nodiscard]] constexpr const Exp2Constants<T>& Exp2Of() noexcept {
  if constexpr (std::is_same_v<T, double>) {
    return kExp2Double;
  } else {
    return kExp2Float;
  }
}

/// All data of a sum in one block of memory, in the order of reading: this header of one cache
/// line, the centre, and the terms of a GaussianTerms. The rows of the blocks of a group are
/// interleaved: row 0 of each block, then row 1 of each block. Processors prefetch ascending
/// addresses.
template <typename T>
struct alignas(64) SumBlock {
  static constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;

  /// Number of cache lines of the whole block.
  [[nodiscard]] static std::size_t Lines(const GaussianTerms<T>& terms) noexcept;
  /// Writes the block to `memory`, which has room for Lines(terms) CacheLines.
  static const SumBlock& Write(const GaussianTerms<T>& terms, void* memory);

  /// Same as GaussianTerms::Scale().
  [[nodiscard]] bool Scale(const double* x, T* scaled) const noexcept {
    return ScaleState(x, center(), scale, dim, scaled);
  }
  [[nodiscard]] const double* center() const noexcept {
    return reinterpret_cast<const double*>(this + 1);
  }
  [[nodiscard]] const T* data() const noexcept {
    return reinterpret_cast<const T*>(this + 1) + (dim + 7) / 8 * kLanes;
  }

  SumFunctions<T> functions;
  std::size_t dim;
  std::size_t num_blocks;
  double scale;
};

/// A SumBlock with its memory.
template <typename T>
class SumTerms {
 public:
  explicit SumTerms(const GaussianTerms<T>& terms)
      : memory_(SumBlock<T>::Lines(terms)), block_(&SumBlock<T>::Write(terms, memory_.data())) {}
  [[nodiscard]] const SumBlock<T>& operator*() const noexcept { return *block_; }
  [[nodiscard]] const SumBlock<T>* operator->() const noexcept { return block_; }

 private:
  AlignedVector<CacheLine> memory_;
  const SumBlock<T>* block_;
};

extern template struct SumBlock<double>;
extern template struct SumBlock<float>;

}  // namespace dfr::kernel::internal
