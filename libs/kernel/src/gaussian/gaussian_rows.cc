#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <type_traits>

#include "gaussian/gaussian_sum.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gaussian/gaussian_rows.cc"
#include "hwy/foreach_target.h"  // recompiles this file for each instruction set
#include "hwy/highway.h"
// Must follow foreach_target.h, like every header that is compiled once per instruction set.
#include "gaussian/gaussian_simd.h"
HWY_BEFORE_NAMESPACE();
namespace dfr::kernel::internal::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

template <typename T>
void Row(const GaussianTerms<T>& terms, const T* HWY_RESTRICT x, T* HWY_RESTRICT row) {
  constexpr Tag<T> d;
  ForTerms<Layout::kBlocks>(terms.data.data(), terms.num_blocks, terms.dim, x,
                            [&](std::size_t j, auto term)
                                HWY_ATTR { hn::Store(term, d, row + j * hn::MaxLanes(d)); });
}

// Writes the sum and the largest absolute entry of each column in kVectors vectors of columns, from
// column `first` on. The largest entry ignores NaN. A vector may extend beyond the end of a row, so
// the last rows are copied before they are loaded.
template <std::size_t kVectors>
HWY_INLINE void MeasureVectors(const double* HWY_RESTRICT rows, std::size_t count, std::size_t dim,
                               std::size_t first, double* HWY_RESTRICT sums,
                               double* HWY_RESTRICT most) {
  constexpr Tag<double> d;
  constexpr std::size_t kStep = hn::MaxLanes(d);
  constexpr std::size_t kWidth = kVectors * kStep;
  hn::Vec<Tag<double>> sum[kVectors];
  hn::Vec<Tag<double>> largest[kVectors];
  HWY_UNROLL(4)
  for (std::size_t v = 0; v < kVectors; ++v) sum[v] = largest[v] = hn::Zero(d);
  const auto add = [&](const double* HWY_RESTRICT row) HWY_ATTR {
    HWY_UNROLL(4)
    for (std::size_t v = 0; v < kVectors; ++v) {
      const auto entry = hn::LoadU(d, row + v * kStep);
      const auto size = hn::Abs(entry);
      sum[v] = hn::Add(sum[v], entry);
      largest[v] = hn::IfThenElse(hn::Gt(size, largest[v]), size, largest[v]);
    }
  };
  const std::size_t own = std::min(kWidth, dim - first);
  std::size_t i = 0;
  for (; i < count && (count - i) * dim >= first + kWidth; ++i) add(rows + i * dim + first);
  alignas(64) double copy[kWidth] = {};
  for (; i < count; ++i) {
    std::copy_n(rows + i * dim + first, own, copy);
    add(copy);
  }
  const auto write = [&](const auto* from, double* HWY_RESTRICT to) HWY_ATTR {
    HWY_UNROLL(4)
    for (std::size_t v = 0; v < kVectors; ++v) hn::Store(from[v], d, copy + v * kStep);
    std::copy_n(copy, own, to + first);
  };
  write(sum, sums);
  write(largest, most);
}

void Columns(const double* rows, std::size_t count, std::size_t dim, double* sums, double* most) {
  constexpr std::size_t kStep = hn::MaxLanes(Tag<double>());
  std::size_t first = 0;
  for (; first + 2 * kStep < dim; first += std::min(4 * kStep, dim - first)) {
    MeasureVectors<4>(rows, count, dim, first, sums, most);
  }
  if (first + kStep < dim) {
    MeasureVectors<2>(rows, count, dim, first, sums, most);
  } else if (first < dim) {
    MeasureVectors<1>(rows, count, dim, first, sums, most);
  }
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

// Computes Row() of all points, each row from the block of its point on. Copies the earlier entries
// from the rows above, which have the same bits.
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
      ForTerms<Layout::kBlocks>(
          terms.data.data() + b * (terms.dim + 1) * kLanes, terms.num_blocks - b, terms.dim, point,
          [&](std::size_t j, auto term)
              HWY_ATTR { hn::Store(term, d, row + first + j * hn::MaxLanes(d)); });
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
  ForGroups<Layout::kBlocks>(terms.data.data(), terms.num_blocks, terms.dim, x,
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
      Exponents<Layout::kBlocks, kVectors>(block, dim, queries + q * dim, exponent);
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
  constexpr std::size_t kBlocks = BlocksTogether<T>();
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

// Writes the groups whose box is within sqrt(reach) of x to `groups` and returns their number.
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
      Exponents<Layout::kBlocks, kPartVectors>(
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
  return {.row = &Row<T>,
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
HWY_EXPORT(Columns);

void MeasureColumns(const double* rows, std::size_t count, std::size_t dim, double* sums,
                    double* most) noexcept {
  HWY_DYNAMIC_DISPATCH(Columns)(rows, count, dim, sums, most);
}

template <>
GaussianFunctions<double> BestFunctions() {
  return HWY_DYNAMIC_DISPATCH(DoubleFunctions)();
}
template <>
GaussianFunctions<float> BestFunctions() {
  return HWY_DYNAMIC_DISPATCH(FloatFunctions)();
}

}  // namespace dfr::kernel::internal
#endif  // HWY_ONCE
