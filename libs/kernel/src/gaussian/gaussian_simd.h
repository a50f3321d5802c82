// Shared by the SIMD code of sums and of rows, compiled once per instruction set.
#if defined(DFR_KERNEL_GAUSSIAN_SIMD_H) == defined(HWY_TARGET_TOGGLE)
#ifdef DFR_KERNEL_GAUSSIAN_SIMD_H
#undef DFR_KERNEL_GAUSSIAN_SIMD_H
#else
#define DFR_KERNEL_GAUSSIAN_SIMD_H
#endif

#include <algorithm>
#include <cstddef>
#include <type_traits>

#include "gaussian/gaussian_terms.h"
#include "gaussian/sum_block.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace dfr::kernel::internal::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// 2^f on [0, 1) with relative errors of 8.3e-8 (float) and 2.3e-16 (double) (Remez; the constant
// term is 1 to make k(x, x) = 1).
template <class D, class V>
HWY_INLINE V Exp2OfFraction(D d, V f) {
  using T = hn::TFromD<D>;
  const auto coefficient = [d](std::size_t k)
                               HWY_ATTR { return hn::Set(d, Exp2Of<T>().coefficients[k]); };
  V p = coefficient(0);
  HWY_UNROLL(16)
  for (std::size_t k = 1; k < Exp2Constants<T>::kDegree; ++k) p = hn::MulAdd(p, f, coefficient(k));
  return hn::MulAdd(p, f, coefficient(Exp2Constants<T>::kDegree));
}

// 2^e for e <= 1024, zero below the smallest normal number. Vector operations on denormal numbers
// take more than a hundred cycles on Intel processors.
template <class D, class V>
HWY_INLINE V Exp2(D d, V e) {
  using T = hn::TFromD<D>;
  constexpr bool kSingle = sizeof(T) == 4;
  const auto normal = hn::Ge(e, hn::Set(d, Exp2Of<T>().least));
#if HWY_TARGET <= HWY_AVX3
  // Highway has no names for two instructions: e - floor(e) and p * 2^floor(e).
  constexpr int kFloorNoException = 0x09;
  if constexpr (kSingle) {
    const V f{_mm512_reduce_ps(e.raw, kFloorNoException)};
    return V{_mm512_maskz_scalef_ps(normal.raw, Exp2OfFraction(d, f).raw, e.raw)};
  } else {
    const V f{_mm512_reduce_pd(e.raw, kFloorNoException)};
    return V{_mm512_maskz_scalef_pd(normal.raw, Exp2OfFraction(d, f).raw, e.raw)};
  }
#else
  const hn::RebindToSigned<D> di;
  const V n = hn::Floor(e);
  const V p = Exp2OfFraction(d, hn::Sub(e, n));
  const V shifted = hn::Add(n, hn::Set(d, Exp2Of<T>().round));
  constexpr int kMantissaBits = kSingle ? 23 : 52;
  return hn::IfThenElseZero(
      normal, hn::BitCast(d, hn::Add(hn::BitCast(di, p),
                                     hn::ShiftLeft<kMantissaBits>(hn::BitCast(di, shifted)))));
#endif
}

template <typename T>
using Tag = hn::CappedTag<T, GaussianTerms<T>::kLanes>;
template <typename T>
constexpr std::size_t VectorsPerBlock() {
  return GaussianTerms<T>::kLanes / hn::MaxLanes(Tag<T>());
}
// Number of vectors evaluated together: enough independent chains to hide the latency of an FMA.
// With 16 registers, more than four spill.
constexpr std::size_t kTogether = HWY_TARGET <= HWY_AVX3 ? 8 : 4;

// Memory layout of a group of kVectors successive vectors of terms.
enum class Layout {
  kBlocks,  // GaussianTerms: block by block
  kGroups,  // SumBlock: row by row of the whole group, in the order in which Exponents() loads
};

// Computes the exponents of kVectors successive vectors of terms, starting at `block`.
template <Layout kLayout, std::size_t kVectors, typename T>
HWY_INLINE void Exponents(const T* HWY_RESTRICT block, std::size_t dim, const T* HWY_RESTRICT x,
                          hn::Vec<Tag<T>>* HWY_RESTRICT exponent) {
  constexpr Tag<T> d;
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  constexpr std::size_t kPerBlock = VectorsPerBlock<T>();
  const std::size_t stride = (dim + 1) * kLanes;
  const auto at = [&](std::size_t j, std::size_t row) HWY_ATTR {
    if constexpr (kLayout == Layout::kGroups) {
      return hn::Load(d, block + (row * kVectors + j) * hn::MaxLanes(d));
    } else {
      return hn::Load(
          d, block + j / kPerBlock * stride + row * kLanes + j % kPerBlock * hn::MaxLanes(d));
    }
  };
  HWY_UNROLL(8)
  for (std::size_t j = 0; j < kVectors; ++j) exponent[j] = at(j, 0);
  for (std::size_t k = 0; k < dim; ++k) {
    const auto query = hn::Set(d, x[k]);
    HWY_UNROLL(8)
    for (std::size_t j = 0; j < kVectors; ++j) {
      const auto diff = hn::Sub(query, at(j, 1 + k));
      exponent[j] = hn::NegMulAdd(diff, diff, exponent[j]);
    }
  }
}

// Number of blocks evaluated together.
template <typename T>
constexpr std::size_t BlocksTogether() {
  return std::max<std::size_t>(1, kTogether / VectorsPerBlock<T>());
}

// Passes the exponents of all vectors of terms to `use(index, exponents, count)`, `count` vectors
// at a time, in the groups of GroupBlocks().
template <Layout kLayout, typename T, class Use>
HWY_INLINE void ForGroups(const T* HWY_RESTRICT data, std::size_t num_blocks, std::size_t dim,
                          const T* HWY_RESTRICT x, Use&& use) {
  constexpr std::size_t kPerBlock = VectorsPerBlock<T>();
  constexpr std::size_t kBlocks = BlocksTogether<T>();
  const std::size_t stride = (dim + 1) * GaussianTerms<T>::kLanes;
  std::size_t b = 0;
  const auto group = [&](auto blocks) HWY_ATTR {
    constexpr std::size_t kVectors = decltype(blocks)::value * kPerBlock;
    hn::Vec<Tag<T>> exponent[kVectors];
    Exponents<kLayout, kVectors>(data + b * stride, dim, x, exponent);
    use(b * kPerBlock, exponent, std::integral_constant<std::size_t, kVectors>());
    b += decltype(blocks)::value;
  };
  // group() advances b. NOLINTNEXTLINE(bugprone-infinite-loop)
  while (b + kBlocks <= num_blocks) group(std::integral_constant<std::size_t, kBlocks>());
  if constexpr (kBlocks > 4) {
    if (b + 4 <= num_blocks) group(std::integral_constant<std::size_t, 4>());
  }
  if constexpr (kBlocks > 2) {
    if (b + 2 <= num_blocks) group(std::integral_constant<std::size_t, 2>());
  }
  // NOLINTNEXTLINE(bugprone-infinite-loop)
  while (b < num_blocks) group(std::integral_constant<std::size_t, 1>());
}

// Passes each vector of terms to `use(index, term)`.
template <Layout kLayout, typename T, class Use>
HWY_INLINE void ForTerms(const T* HWY_RESTRICT data, std::size_t num_blocks, std::size_t dim,
                         const T* HWY_RESTRICT x, Use&& use) {
  ForGroups<kLayout>(data, num_blocks, dim, x,
                     [&](std::size_t first, auto* exponent, auto count) HWY_ATTR {
                       constexpr std::size_t kCount = decltype(count)::value;
                       HWY_UNROLL(8)
                       for (std::size_t j = 0; j < kCount; ++j)
                         exponent[j] = Exp2(Tag<T>(), exponent[j]);
                       HWY_UNROLL(8)
                       for (std::size_t j = 0; j < kCount; ++j) use(first + j, exponent[j]);
                     });
}

// Sums terms in two chains, selected by the parity of the index of a vector.
template <typename T>
struct Total {
  hn::Vec<Tag<T>> even;
  hn::Vec<Tag<T>> odd;

  // Written out: a generated constructor would not be compiled for the instruction set.
  HWY_INLINE Total() : even(hn::Zero(Tag<T>())), odd(hn::Zero(Tag<T>())) {}
  template <class V>
  HWY_INLINE void Add(std::size_t j, V term) {
    if (j % 2 == 0) {
      even = hn::Add(even, term);
    } else {
      odd = hn::Add(odd, term);
    }
  }
  HWY_INLINE T Value() const { return hn::GetLane(hn::SumOfLanes(Tag<T>(), hn::Add(even, odd))); }
};

}  // namespace dfr::kernel::internal::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif
