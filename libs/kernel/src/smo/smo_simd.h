// Shared SIMD code of the SMO loops, compiled once per instruction set.
#if defined(DFR_KERNEL_SMO_SIMD_H) == defined(HWY_TARGET_TOGGLE)
#ifdef DFR_KERNEL_SMO_SIMD_H
#undef DFR_KERNEL_SMO_SIMD_H
#else
#define DFR_KERNEL_SMO_SIMD_H
#endif

#include <cstddef>

#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace dfr::kernel::internal::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

template <typename T>
using Tag = hn::CappedTag<T, 64 / sizeof(T)>;
template <typename T>
using Bits = hn::RebindToSigned<Tag<T>>;

// Returns 1 / v, to 14 bits if there is an instruction for it: the choice of a pair may be
// approximate, because the step is exact.
template <class D, class V>
HWY_INLINE V RoughReciprocal(D d, V v) {
#if HWY_TARGET <= HWY_AVX3
  if constexpr (sizeof(hn::TFromD<D>) == 4) return hn::ApproximateReciprocal(v);
#endif
  return hn::Div(hn::Set(d, hn::TFromD<D>(1)), v);
}

// Lower limit of 1 - K_ij, used for equal points.
template <typename T>
constexpr T kLeastCurvature = sizeof(T) == 4 ? T(1.2e-7) : T(1e-12);

// Applies `op` to all lanes; every lane of the result holds the outcome.
template <class D, class V, class Op>
HWY_INLINE V Reduce([[maybe_unused]] D d, V v, [[maybe_unused]] Op&& op) {
#if HWY_TARGET != HWY_SCALAR
  constexpr std::size_t kSize = sizeof(hn::TFromD<D>);
  if constexpr (hn::MaxLanes(D()) * kSize >= 64) v = op(v, hn::ReverseBlocks(d, v));
  if constexpr (hn::MaxLanes(D()) * kSize >= 32) v = op(v, hn::SwapAdjacentBlocks(v));
  if constexpr (kSize == 4) {
    v = op(v, hn::Shuffle1032(v));
    v = op(v, hn::Shuffle2301(v));
  } else {
    v = op(v, hn::Shuffle01(v));
  }
#endif
  return v;
}

// Returns the smallest lane in every lane. Compares floats as integers of the same order, because
// comparisons of integers have a quarter of the latency.
template <typename T>
HWY_INLINE hn::Vec<Tag<T>> LeastOfLanes(hn::Vec<Tag<T>> v) {
  constexpr Tag<T> d;
  const auto least = [](auto a, auto b) HWY_ATTR { return hn::Min(a, b); };
  if constexpr (sizeof(T) == 4) {
    constexpr Bits<T> di;
    // This mapping is its own inverse.
    const auto order = [](auto bits) HWY_ATTR {
      return hn::Xor(bits, hn::And(hn::ShiftRight<31>(bits), hn::Set(Bits<T>(), 0x7fffffff)));
    };
    return hn::BitCast(d, order(Reduce(di, order(hn::BitCast(di, v)), least)));
  } else {
    return Reduce(d, v, least);
  }
}

// Returns the largest lane of a vector without negative lanes, in every lane.
template <typename T>
HWY_INLINE hn::Vec<Tag<T>> MostOfPositiveLanes(hn::Vec<Tag<T>> v) {
  constexpr Tag<T> d;
  const auto most = [](auto a, auto b) HWY_ATTR { return hn::Max(a, b); };
  if constexpr (sizeof(T) == 4) {
    constexpr Bits<T> di;
    return hn::BitCast(d, Reduce(di, hn::BitCast(di, v), most));
  } else {
    return Reduce(d, v, most);
  }
}

// Finds the extreme of many vectors and its index with one reduction: the low bits of each value
// carry the number of its vector. This rounds values by up to 2^-10 (float, 10^5 samples), which
// the choice of a pair tolerates.
template <typename T>
struct Numbered {
  using Int = hn::TFromD<Bits<T>>;

  HWY_INLINE explicit Numbered(std::size_t vectors) : low_bits(0) {
    while (static_cast<std::size_t>(low_bits) + 1 < vectors) low_bits = 2 * low_bits + 1;
  }
  template <class V, class I>
  HWY_INLINE V Mark(V value, I number) const {
    const auto rest = hn::BitCast(Tag<T>(), hn::Set(Bits<T>(), ~low_bits));
    return hn::OrAnd(hn::BitCast(Tag<T>(), number), value, rest);
  }
  // Returns the index of `extreme`, the extreme of all lanes, from the vector of each lane's
  // extremes.
  template <class V>
  HWY_INLINE std::size_t Index(V extremes, V extreme) const {
    constexpr Tag<T> d;
    const auto lane = static_cast<std::size_t>(hn::FindFirstTrue(d, hn::Eq(extremes, extreme)));
    const auto number =
        static_cast<std::size_t>(hn::GetLane(hn::BitCast(Bits<T>(), extreme)) & low_bits);
    return number * hn::MaxLanes(d) + lane;
  }
  Int low_bits;
};

}  // namespace dfr::kernel::internal::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif
