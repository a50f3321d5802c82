#include "gaussian_sum.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <type_traits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gaussian_sum.cc"
#include "hwy/foreach_target.h"  // recompiles this file for each instruction set
#include "hwy/highway.h"
HWY_BEFORE_NAMESPACE();
namespace dfr::kernel::internal::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// 2^f on [0, 1) with relative errors 8.3e-8 and 2.3e-16 (Remez; the constant term is 1 to make k(x,
// x) = 1).
template <class D, class V>
HWY_INLINE V Exp2OfFraction(D d, V f) {
  if constexpr (sizeof(hn::TFromD<D>) == 4) {
    V p = hn::Set(d, 0.0018671300702315652f);
    p = hn::MulAdd(p, f, hn::Set(d, 0.009017030321454624f));
    p = hn::MulAdd(p, f, hn::Set(d, 0.05579991310471325f));
    p = hn::MulAdd(p, f, hn::Set(d, 0.24016445015469612f));
    p = hn::MulAdd(p, f, hn::Set(d, 0.6931513118046542f));
    return hn::MulAdd(p, f, hn::Set(d, 1.0f));
  } else {
    V p = hn::Set(d, 9.935326288527113e-09);
    p = hn::MulAdd(p, f, hn::Set(d, 9.469651597530141e-08));
    p = hn::MulAdd(p, f, hn::Set(d, 1.3310800888130517e-06));
    p = hn::MulAdd(p, f, hn::Set(d, 1.5244895767042944e-05));
    p = hn::MulAdd(p, f, hn::Set(d, 0.00015403939740726082));
    p = hn::MulAdd(p, f, hn::Set(d, 0.0013333544569884535));
    p = hn::MulAdd(p, f, hn::Set(d, 0.009618129384464252));
    p = hn::MulAdd(p, f, hn::Set(d, 0.05550410863258579));
    p = hn::MulAdd(p, f, hn::Set(d, 0.2402265069609467));
    p = hn::MulAdd(p, f, hn::Set(d, 0.693147180559909));
    return hn::MulAdd(p, f, hn::Set(d, 1.0));
  }
}

// 2^e for e <= 1024, zero below the smallest normal number. Vector operations on denormal numbers
// take more than a hundred cycles on Intel processors.
template <class D, class V>
HWY_INLINE V Exp2(D d, V e) {
  using T = hn::TFromD<D>;
  constexpr bool kSingle = sizeof(T) == 4;
  const auto normal = hn::Ge(e, hn::Set(d, kSingle ? T(-126) : T(-1022)));
#if HWY_TARGET <= HWY_AVX3
  // Two instructions without a Highway name: e - floor(e) and p * 2^floor(e).
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
  // Adding 1.5 * 2^mantissa bits moves n into the low bits of the mantissa.
  const V shifted = hn::Add(n, hn::Set(d, kSingle ? T(12582912.0) : T(6755399441055744.0)));
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

// Exponents of kVectors successive vectors of terms, starting at `block`.
template <std::size_t kVectors, typename T>
HWY_INLINE void Exponents(const T* HWY_RESTRICT block, std::size_t dim, const T* HWY_RESTRICT x,
                          hn::Vec<Tag<T>>* HWY_RESTRICT exponent) {
  constexpr Tag<T> d;
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  constexpr std::size_t kPerBlock = VectorsPerBlock<T>();
  const std::size_t stride = (dim + 1) * kLanes;
  const auto at = [&](std::size_t j, std::size_t row) HWY_ATTR {
    return hn::Load(
        d, block + j / kPerBlock * stride + row * kLanes + j % kPerBlock * hn::MaxLanes(d));
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

// Passes the exponents of each vector of terms to `use(index, exponents, count)`, `count` vectors
// at a time, first in groups of kTogether, then in whole blocks.
template <typename T, class Use>
HWY_INLINE void ForGroups(const T* HWY_RESTRICT data, std::size_t num_blocks, std::size_t dim,
                          const T* HWY_RESTRICT x, Use&& use) {
  constexpr std::size_t kPerBlock = VectorsPerBlock<T>();
  constexpr std::size_t kBlocks = std::max<std::size_t>(1, kTogether / kPerBlock);
  const std::size_t stride = (dim + 1) * GaussianTerms<T>::kLanes;
  std::size_t b = 0;
  const auto group = [&](auto blocks) HWY_ATTR {
    constexpr std::size_t kVectors = decltype(blocks)::value * kPerBlock;
    hn::Vec<Tag<T>> exponent[kVectors];
    Exponents<kVectors>(data + b * stride, dim, x, exponent);
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
template <typename T, class Use>
HWY_INLINE void ForTerms(const T* HWY_RESTRICT data, std::size_t num_blocks, std::size_t dim,
                         const T* HWY_RESTRICT x, Use&& use) {
  ForGroups(data, num_blocks, dim, x, [&](std::size_t first, auto* exponent, auto count) HWY_ATTR {
    constexpr std::size_t kCount = decltype(count)::value;
    HWY_UNROLL(8)
    for (std::size_t j = 0; j < kCount; ++j) exponent[j] = Exp2(Tag<T>(), exponent[j]);
    HWY_UNROLL(8)
    for (std::size_t j = 0; j < kCount; ++j) use(first + j, exponent[j]);
  });
}

// Sums terms in two chains, which do not depend on the order of visits.
template <typename T>
struct Total {
  hn::Vec<Tag<T>> even;
  hn::Vec<Tag<T>> odd;

  // Explicit because an implicit constructor would not be compiled for the instruction set.
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

// Terms that stay in L1 while a batch of queries passes over them: 16 KiB, a multiple of every
// group, which keeps Sum()'s order of summation.
template <typename T>
std::size_t TileBlocks(std::size_t dim) {
  constexpr std::size_t kGroup = 8;
  const std::size_t fit = (std::size_t{16} << 10) / (64 * (dim + 1));
  return std::max(fit / kGroup, std::size_t{1}) * kGroup;
}

template <typename T>
void Sums(const GaussianTerms<T>& terms, const T* HWY_RESTRICT x, std::size_t count,
          T* HWY_RESTRICT sums) {
  constexpr std::size_t kBatch = 32;
  const std::size_t tile = TileBlocks<T>(terms.dim);
  const std::size_t stride = (terms.dim + 1) * GaussianTerms<T>::kLanes;
  for (std::size_t first = 0; first < count; first += kBatch) {
    const std::size_t queries = std::min(kBatch, count - first);
    Total<T> totals[kBatch];
    for (std::size_t b = 0; b < terms.num_blocks; b += tile) {
      const std::size_t blocks = std::min(tile, terms.num_blocks - b);
      for (std::size_t q = 0; q < queries; ++q) {
        Total<T> total = totals[q];
        ForTerms(terms.data.data() + b * stride, blocks, terms.dim, x + (first + q) * terms.dim,
                 [&](std::size_t j, auto term) HWY_ATTR { total.Add(j, term); });
        totals[q] = total;
      }
    }
    for (std::size_t q = 0; q < queries; ++q) sums[first + q] = totals[q].Value();
  }
}

template <typename T>
T Largest(const GaussianTerms<T>& terms, const T* HWY_RESTRICT x) {
  constexpr Tag<T> d;
  auto largest = hn::Set(d, -std::numeric_limits<T>::infinity());
  ForGroups(terms.data.data(), terms.num_blocks, terms.dim, x,
            [&](std::size_t, const auto* exponent, auto count) HWY_ATTR {
              for (std::size_t j = 0; j < decltype(count)::value; ++j) {
                largest = hn::Max(largest, exponent[j]);
              }
            });
  return hn::GetLane(hn::MaxOfLanes(d, largest));
}

template <typename T>
T Sum(const GaussianTerms<T>& terms, const T* HWY_RESTRICT x) {
  Total<T> total;
  ForTerms(terms.data.data(), terms.num_blocks, terms.dim, x,
           [&](std::size_t j, auto term) HWY_ATTR { total.Add(j, term); });
  return total.Value();
}

template <typename T>
void Row(const GaussianTerms<T>& terms, const T* HWY_RESTRICT x, T* HWY_RESTRICT row) {
  constexpr Tag<T> d;
  ForTerms(terms.data.data(), terms.num_blocks, terms.dim, x,
           [&](std::size_t j, auto term)
               HWY_ATTR { hn::Store(term, d, row + j * hn::MaxLanes(d)); });
}

// Copies a square with kSide<T> entries per side, transposed.
#if HWY_TARGET == HWY_SCALAR
template <typename T>
constexpr std::size_t kSide = 1;
template <typename T>
HWY_INLINE void Transpose(const T* HWY_RESTRICT from, T* HWY_RESTRICT to, std::size_t) {
  *to = *from;
}
#else
template <typename T>
constexpr std::size_t kSide = 16 / sizeof(T);
template <typename T>
HWY_INLINE void Transpose(const T* HWY_RESTRICT from, T* HWY_RESTRICT to, std::size_t stride) {
  constexpr hn::FixedTag<T, kSide<T>> d;
  const auto a = hn::Load(d, from);
  const auto b = hn::Load(d, from + stride);
  if constexpr (sizeof(T) == sizeof(double)) {
    hn::Store(hn::ConcatLowerLower(d, b, a), d, to);
    hn::Store(hn::ConcatUpperUpper(d, b, a), d, to + stride);
  } else {
    const auto e = hn::Load(d, from + 2 * stride);
    const auto f = hn::Load(d, from + 3 * stride);
    const auto ab = hn::InterleaveLower(d, a, b);
    const auto ef = hn::InterleaveLower(d, e, f);
    hn::Store(hn::ConcatLowerLower(d, ef, ab), d, to);
    hn::Store(hn::ConcatUpperUpper(d, ef, ab), d, to + stride);
    const auto ab_upper = hn::InterleaveUpper(d, a, b);
    const auto ef_upper = hn::InterleaveUpper(d, e, f);
    hn::Store(hn::ConcatLowerLower(d, ef_upper, ab_upper), d, to + 2 * stride);
    hn::Store(hn::ConcatUpperUpper(d, ef_upper, ab_upper), d, to + 3 * stride);
  }
}
#endif

// Row() of all points, for the blocks from their own block on. The rows above have computed the
// rest, with the same bits.
template <typename T>
void AllRows(const GaussianTerms<T>& terms, T* HWY_RESTRICT point, T* HWY_RESTRICT rows,
             T* HWY_RESTRICT sums) {
  constexpr Tag<T> d;
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  const std::size_t size = terms.row_size();
  for (std::size_t b = 0; b < terms.num_blocks; ++b) {
    const std::size_t first = b * kLanes;
    const std::size_t last = std::min(first + kLanes, terms.count);
    for (std::size_t above = 0; above < first; above += kLanes) {
      for (std::size_t i = 0; i < kLanes; i += kSide<T>) {
        for (std::size_t j = 0; j < kLanes; j += kSide<T>) {
          Transpose(rows + (above + i) * size + first + j, rows + (first + j) * size + above + i,
                    size);
        }
      }
    }
    for (std::size_t i = first; i < last; ++i) {
      terms.Point(i, point);
      T* HWY_RESTRICT row = rows + i * size;
      ForTerms(terms.data.data() + b * (terms.dim + 1) * kLanes, terms.num_blocks - b, terms.dim,
               point, [&](std::size_t j, auto term) HWY_ATTR {
                 hn::Store(term, d, row + first + j * hn::MaxLanes(d));
               });
      Total<T> left;
      Total<T> right;
      std::size_t j = 0;
      for (; j + 4 * hn::MaxLanes(d) <= size; j += 4 * hn::MaxLanes(d)) {
        left.Add(0, hn::Load(d, row + j));
        left.Add(1, hn::Load(d, row + j + hn::MaxLanes(d)));
        right.Add(0, hn::Load(d, row + j + 2 * hn::MaxLanes(d)));
        right.Add(1, hn::Load(d, row + j + 3 * hn::MaxLanes(d)));
      }
      for (; j < size; j += hn::MaxLanes(d)) left.Add(0, hn::Load(d, row + j));
      sums[i] = left.Value() + right.Value();
    }
  }
}

template <typename T>
void ExponentsOf(const GaussianTerms<T>& terms, const T* HWY_RESTRICT x, T* HWY_RESTRICT row) {
  constexpr Tag<T> d;
  ForGroups(terms.data.data(), terms.num_blocks, terms.dim, x,
            [&](std::size_t first, const auto* exponent, auto count) HWY_ATTR {
              for (std::size_t j = 0; j < decltype(count)::value; ++j) {
                hn::Store(exponent[j], d, row + (first + j) * hn::MaxLanes(d));
              }
            });
}

template <typename T>
void Powers(const T* HWY_RESTRICT exponents, T factor, std::size_t size, T* HWY_RESTRICT row) {
  constexpr Tag<T> d;
  const auto scale = hn::Set(d, factor);
  HWY_UNROLL(4)
  for (std::size_t k = 0; k < size; k += hn::MaxLanes(d)) {
    hn::Store(Exp2(d, hn::Mul(scale, hn::Load(d, exponents + k))), d, row + k);
  }
}

// Adds sum_q weight_q term_i(x_q) to total_i for one group of kVectors vectors of terms, which stay
// in L1 while all queries pass over them. Sums in T run over few queries and are then added in
// double.
template <std::size_t kVectors, typename T>
HWY_INLINE void AddRowsToGroup(const T* HWY_RESTRICT block, std::size_t dim,
                               const T* HWY_RESTRICT queries, const T* HWY_RESTRICT weights,
                               std::size_t count, double* HWY_RESTRICT totals) {
  constexpr Tag<T> d;
  constexpr std::size_t kStep = hn::MaxLanes(d);
  constexpr std::size_t kRun = 32;
  alignas(64) T flushed[kVectors * kStep];
  for (std::size_t first = 0; first < count; first += kRun) {
    const std::size_t last = std::min(first + kRun, count);
    hn::Vec<Tag<T>> sum[kVectors];
    HWY_UNROLL(8)
    for (std::size_t j = 0; j < kVectors; ++j) sum[j] = hn::Zero(d);
    for (std::size_t q = first; q < last; ++q) {
      hn::Vec<Tag<T>> exponent[kVectors];
      Exponents<kVectors>(block, dim, queries + q * dim, exponent);
      const auto weight = hn::Set(d, weights[q]);
      HWY_UNROLL(8)
      for (std::size_t j = 0; j < kVectors; ++j) {
        sum[j] = hn::MulAdd(weight, Exp2(d, exponent[j]), sum[j]);
      }
    }
    HWY_UNROLL(8)
    for (std::size_t j = 0; j < kVectors; ++j) hn::Store(sum[j], d, flushed + j * kStep);
    for (std::size_t i = 0; i < kVectors * kStep; ++i) totals[i] += static_cast<double>(flushed[i]);
  }
}

template <typename T>
void AddRows(const GaussianTerms<T>& terms, std::size_t first, std::size_t last,
             const T* HWY_RESTRICT queries, const T* HWY_RESTRICT weights, std::size_t count,
             double* HWY_RESTRICT totals) {
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  constexpr std::size_t kPerBlock = VectorsPerBlock<T>();
  constexpr std::size_t kBlocks = std::max<std::size_t>(1, kTogether / kPerBlock);
  const std::size_t stride = (terms.dim + 1) * kLanes;
  std::size_t b = first;
  for (; b + kBlocks <= last; b += kBlocks) {
    AddRowsToGroup<kBlocks * kPerBlock>(terms.data.data() + b * stride, terms.dim, queries, weights,
                                        count, totals + b * kLanes);
  }
  for (; b < last; ++b) {
    AddRowsToGroup<kPerBlock>(terms.data.data() + b * stride, terms.dim, queries, weights, count,
                              totals + b * kLanes);
  }
}

// Number of features summed together in the second pass: the term is loaded once for all of them.
constexpr std::size_t kFeatures = 4;

template <std::size_t kCount, typename T>
HWY_INLINE void AddShift(const T* HWY_RESTRICT data, const T* HWY_RESTRICT row,
                         std::size_t num_blocks, std::size_t dim, std::size_t first,
                         const T* HWY_RESTRICT x, T* HWY_RESTRICT shift) {
  constexpr Tag<T> d;
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  hn::Vec<Tag<T>> sum[kCount];
  hn::Vec<Tag<T>> query[kCount];
  HWY_UNROLL(4)
  for (std::size_t k = 0; k < kCount; ++k) {
    sum[k] = hn::Zero(d);
    query[k] = hn::Set(d, x[first + k]);
  }
  for (std::size_t b = 0; b < num_blocks; ++b) {
    const T* HWY_RESTRICT coordinates = data + (b * (dim + 1) + 1 + first) * kLanes;
    for (std::size_t lane = 0; lane < kLanes; lane += hn::MaxLanes(d)) {
      const auto term = hn::Load(d, row + b * kLanes + lane);
      HWY_UNROLL(4)
      for (std::size_t k = 0; k < kCount; ++k) {
        const auto diff = hn::Sub(hn::Load(d, coordinates + k * kLanes + lane), query[k]);
        sum[k] = hn::MulAdd(term, diff, sum[k]);
      }
    }
  }
  for (std::size_t k = 0; k < kCount; ++k) {
    shift[first + k] += hn::GetLane(hn::SumOfLanes(d, sum[k]));
  }
}

template <typename T>
T SumShift(const GaussianTerms<T>& terms, const T* HWY_RESTRICT x, T offset,
           T* HWY_RESTRICT shift) {
  constexpr Tag<T> d;
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  // Number of blocks whose terms fill 4 KiB; a multiple of every group, which makes the sum equal
  // to Sum()'s.
  constexpr std::size_t kChunk = 4096 / kLanes / sizeof(T);
  alignas(64) T row[kChunk * kLanes];
  std::fill_n(shift, terms.dim, T{0});
  Total<T> total;
  for (std::size_t b = 0; b < terms.num_blocks; b += kChunk) {
    const std::size_t blocks = std::min(kChunk, terms.num_blocks - b);
    const T* data = terms.data.data() + b * (terms.dim + 1) * kLanes;
    ForGroups(data, blocks, terms.dim, x,
              [&](std::size_t first, auto* exponent, auto count) HWY_ATTR {
                HWY_UNROLL(8)
                for (std::size_t j = 0; j < decltype(count)::value; ++j) {
                  const auto term = Exp2(d, hn::Add(exponent[j], hn::Set(d, offset)));
                  hn::Store(term, d, row + (first + j) * hn::MaxLanes(d));
                  total.Add(first + j, term);
                }
              });
    std::size_t k = 0;
    for (; k + kFeatures <= terms.dim; k += kFeatures) {
      AddShift<kFeatures>(data, row, blocks, terms.dim, k, x, shift);
    }
    for (; k < terms.dim; ++k) AddShift<1>(data, row, blocks, terms.dim, k, x, shift);
  }
  return total.Value();
}

// Appends the groups whose box is within `reach` of x to `groups`.
template <typename T>
std::size_t NearGroups(const GroupBoxes<T>& boxes, const T* HWY_RESTRICT x, T reach,
                       std::uint32_t* HWY_RESTRICT groups) {
  constexpr Tag<T> d;
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  alignas(64) T squared[kLanes];
  std::size_t count = 0;
  for (std::size_t first = 0; first < boxes.count; first += kLanes) {
    const T* HWY_RESTRICT corners = boxes.data.data() + 2 * first * boxes.dim;
    for (std::size_t lane = 0; lane < kLanes; lane += hn::MaxLanes(d)) {
      auto sum = hn::Zero(d);
      for (std::size_t k = 0; k < boxes.dim; ++k) {
        const auto query = hn::Set(d, x[k]);
        const auto below = hn::Sub(hn::Load(d, corners + 2 * k * kLanes + lane), query);
        const auto above = hn::Sub(query, hn::Load(d, corners + (2 * k + 1) * kLanes + lane));
        const auto outside = hn::Max(hn::Max(below, above), hn::Zero(d));
        sum = hn::MulAdd(outside, outside, sum);
      }
      hn::Store(sum, d, squared + lane);
    }
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      groups[count] = static_cast<std::uint32_t>(first + lane);
      count += squared[lane] <= reach ? 1 : 0;
    }
  }
  return count;
}

template <typename T>
std::size_t NearRow(const GaussianTerms<T>& terms, const T* HWY_RESTRICT x, T reach,
                    std::uint32_t* HWY_RESTRICT groups, std::size_t count, T* HWY_RESTRICT values) {
  constexpr Tag<T> d;
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  constexpr std::size_t kVectors = GroupBoxes<T>::kGroup / hn::MaxLanes(d);
  constexpr std::size_t kPart = std::min(kVectors, kTogether);
  constexpr std::size_t kPartBlocks = std::max<std::size_t>(1, kPart / VectorsPerBlock<T>());
  constexpr std::size_t kPartVectors = kPartBlocks * VectorsPerBlock<T>();
  const std::size_t stride = (terms.dim + 1) * kLanes;
  std::size_t kept = 0;
  for (std::size_t q = 0; q < count; ++q) {
    const std::uint32_t group = groups[q];
    T* HWY_RESTRICT row = values + kept * GroupBoxes<T>::kGroup;
    auto largest = hn::Set(d, -std::numeric_limits<T>::infinity());
    for (std::size_t b = 0; b < GroupBoxes<T>::kGroup / kLanes; b += kPartBlocks) {
      hn::Vec<Tag<T>> exponent[kPartVectors];
      Exponents<kPartVectors>(
          terms.data.data() + (group * (GroupBoxes<T>::kGroup / kLanes) + b) * stride, terms.dim, x,
          exponent);
      HWY_UNROLL(8)
      for (std::size_t j = 0; j < kPartVectors; ++j) {
        largest = hn::Max(largest, exponent[j]);
        hn::Store(exponent[j], d, row + b * kLanes + j * hn::MaxLanes(d));
      }
    }
    if (hn::AllFalse(d, hn::Ge(largest, hn::Set(d, -reach)))) continue;
    HWY_UNROLL(8)
    for (std::size_t k = 0; k < GroupBoxes<T>::kGroup; k += hn::MaxLanes(d)) {
      hn::Store(Exp2(d, hn::Load(d, row + k)), d, row + k);
    }
    groups[kept++] = group;
  }
  return kept;
}

template <typename T>
GaussianFunctions<T> Functions() {
  return {.sum = &Sum<T>,
          .sums = &Sums<T>,
          .sum_shift = &SumShift<T>,
          .largest = &Largest<T>,
          .row = &Row<T>,
          .all_rows = &AllRows<T>,
          .exponents = &ExponentsOf<T>,
          .powers = &Powers<T>,
          .add_rows = &AddRows<T>,
          .near_groups = &NearGroups<T>,
          .near_row = &NearRow<T>};
}
GaussianFunctions<double> DoubleFunctions() { return Functions<double>(); }
GaussianFunctions<float> FloatFunctions() { return Functions<float>(); }

}  // namespace dfr::kernel::internal::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dfr::kernel::internal {

HWY_EXPORT(DoubleFunctions);
HWY_EXPORT(FloatFunctions);

double GaussianSumReference(const core::Matrix& points, std::span<const double> weights,
                            double gamma, std::span<const double> x) noexcept {
  double sum = 0.0;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    double squared = 0.0;
    for (std::size_t k = 0; k < x.size(); ++k) {
      const double diff = x[k] - points(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(k));
      squared += diff * diff;
    }
    sum += weights[i] * std::exp(-gamma * squared);
  }
  return sum;
}

template <>
GaussianFunctions<double> BestFunctions() {
  return HWY_DYNAMIC_DISPATCH(DoubleFunctions)();
}
template <>
GaussianFunctions<float> BestFunctions() {
  return HWY_DYNAMIC_DISPATCH(FloatFunctions)();
}

std::vector<std::int64_t> SupportedTargets() { return hwy::SupportedAndGeneratedTargets(); }

const char* TargetName(std::int64_t target) { return hwy::TargetName(target); }

void ForceTarget(std::int64_t target) {
  hwy::SetSupportedTargetsForTest(target);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
}

}  // namespace dfr::kernel::internal
#endif  // HWY_ONCE
