#include "gaussian/gaussian_sum.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <type_traits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gaussian/gaussian_sum.cc"
#include "hwy/foreach_target.h"  // recompiles this file for each instruction set
#include "hwy/highway.h"
// Must follow foreach_target.h, like every header that is compiled once per instruction set.
#include "gaussian/gaussian_simd.h"
HWY_BEFORE_NAMESPACE();
namespace dfr::kernel::internal::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Number of blocks whose terms stay in L1 (16 KiB) while a batch of queries passes over them. It is
// a multiple of every group's size, which keeps Sum()'s order of summation.
template <typename T>
std::size_t TileBlocks(std::size_t dim) {
  constexpr std::size_t kGroup = 8;
  const std::size_t fit = (std::size_t{16} << 10) / (64 * (dim + 1));
  return std::max(fit / kGroup, std::size_t{1}) * kGroup;
}

template <typename T>
void Sums(const SumBlock<T>& terms, const T* HWY_RESTRICT x, std::size_t count,
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
        ForTerms<Layout::kGroups>(terms.data() + b * stride, blocks, terms.dim,
                                  x + (first + q) * terms.dim,
                                  [&](std::size_t j, auto term) HWY_ATTR { total.Add(j, term); });
        totals[q] = total;
      }
    }
    for (std::size_t q = 0; q < queries; ++q) sums[first + q] = totals[q].Value();
  }
}

template <typename T>
[[gnu::hot]] T Largest(const SumBlock<T>& terms, const T* HWY_RESTRICT x) {
  constexpr Tag<T> d;
  auto largest = hn::Set(d, -std::numeric_limits<T>::infinity());
  ForGroups<Layout::kGroups>(terms.data(), terms.num_blocks, terms.dim, x,
                             [&](std::size_t, const auto* exponent, auto count) HWY_ATTR {
                               for (std::size_t j = 0; j < decltype(count)::value; ++j) {
                                 largest = hn::Max(largest, exponent[j]);
                               }
                             });
  return hn::GetLane(hn::MaxOfLanes(d, largest));
}

template <typename T>
[[gnu::hot]] T Sum(const SumBlock<T>& terms, const T* HWY_RESTRICT x) {
  Total<T> total;
  ForTerms<Layout::kGroups>(terms.data(), terms.num_blocks, terms.dim, x,
                            [&](std::size_t j, auto term) HWY_ATTR { total.Add(j, term); });
  return total.Value();
}

// Number of features summed together in the second pass, which loads each term once for all of
// them.
constexpr std::size_t kFeatures = 4;

// Adds sum_i term_i (s'_i - x') of kCount features from `first` on to `sum`: in groups of kGroup
// blocks, then in smaller groups, as in GroupBlocks(). The width of a group is a compile-time
// constant, which lets the loads of all features share one base address.
template <std::size_t kGroup, std::size_t kCount, typename T>
HWY_INLINE void AddGroups(const T* HWY_RESTRICT data, const T* HWY_RESTRICT row,
                          std::size_t num_blocks, std::size_t dim, std::size_t first,
                          const hn::Vec<Tag<T>>* HWY_RESTRICT query,
                          hn::Vec<Tag<T>>* HWY_RESTRICT sum) {
  constexpr Tag<T> d;
  constexpr std::size_t kWidth = kGroup * GaussianTerms<T>::kLanes;
  for (; num_blocks >= kGroup; num_blocks -= kGroup) {
    const T* HWY_RESTRICT coordinates = data + (1 + first) * kWidth;
    HWY_UNROLL(4)
    for (std::size_t lane = 0; lane < kWidth; lane += hn::MaxLanes(d)) {
      const auto term = hn::Load(d, row + lane);
      HWY_UNROLL(4)
      for (std::size_t k = 0; k < kCount; ++k) {
        const auto diff = hn::Sub(hn::Load(d, coordinates + k * kWidth + lane), query[k]);
        sum[k] = hn::MulAdd(term, diff, sum[k]);
      }
    }
    data += (dim + 1) * kWidth;
    row += kWidth;
  }
  if constexpr (kGroup > 1) {
    AddGroups<kGroup / 2, kCount>(data, row, num_blocks, dim, first, query, sum);
  }
}

template <std::size_t kCount, typename T>
HWY_INLINE void AddShift(const T* HWY_RESTRICT data, const T* HWY_RESTRICT row,
                         std::size_t num_blocks, std::size_t dim, std::size_t first,
                         const T* HWY_RESTRICT x, T* HWY_RESTRICT shift) {
  constexpr Tag<T> d;
  hn::Vec<Tag<T>> sum[kCount];
  hn::Vec<Tag<T>> query[kCount];
  HWY_UNROLL(4)
  for (std::size_t k = 0; k < kCount; ++k) {
    sum[k] = hn::Zero(d);
    query[k] = hn::Set(d, x[first + k]);
  }
  AddGroups<BlocksTogether<T>(), kCount>(data, row, num_blocks, dim, first, query, sum);
  HWY_UNROLL(4)
  for (std::size_t k = 0; k < kCount; ++k) {
    shift[first + k] += hn::GetLane(hn::SumOfLanes(d, sum[k]));
  }
}

template <typename T>
[[gnu::hot]] T SumShift(const SumBlock<T>& terms, const T* HWY_RESTRICT x, T offset,
                        T* HWY_RESTRICT shift) {
  constexpr Tag<T> d;
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  // Number of blocks whose terms fill 4 KiB; a multiple of every group's size, which makes the sum
  // equal to Sum()'s.
  constexpr std::size_t kChunk = 4096 / kLanes / sizeof(T);
  alignas(64) T row[kChunk * kLanes];
  std::fill_n(shift, terms.dim, T{0});
  Total<T> total;
  for (std::size_t b = 0; b < terms.num_blocks; b += kChunk) {
    const std::size_t blocks = std::min(kChunk, terms.num_blocks - b);
    const T* data = terms.data() + b * (terms.dim + 1) * kLanes;
    ForGroups<Layout::kGroups>(
        data, blocks, terms.dim, x, [&](std::size_t first, auto* exponent, auto count) HWY_ATTR {
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

template <typename T>
SumFunctions<T> Functions() {
  return {.sum = &Sum<T>,
          .sums = &Sums<T>,
          .sum_shift = &SumShift<T>,
          .largest = &Largest<T>,
          .together = BlocksTogether<T>()};
}
SumFunctions<double> DoubleSumFunctions() { return Functions<double>(); }
SumFunctions<float> FloatSumFunctions() { return Functions<float>(); }

}  // namespace dfr::kernel::internal::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dfr::kernel::internal {

HWY_EXPORT(DoubleSumFunctions);
HWY_EXPORT(FloatSumFunctions);

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
SumFunctions<double> BestSumFunctions() {
  return HWY_DYNAMIC_DISPATCH(DoubleSumFunctions)();
}
template <>
SumFunctions<float> BestSumFunctions() {
  return HWY_DYNAMIC_DISPATCH(FloatSumFunctions)();
}

std::vector<std::int64_t> SupportedTargets() { return hwy::SupportedAndGeneratedTargets(); }

const char* TargetName(std::int64_t target) { return hwy::TargetName(target); }

void ForceTarget(std::int64_t target) {
  hwy::SetSupportedTargetsForTest(target);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
}

}  // namespace dfr::kernel::internal
#endif  // HWY_ONCE
