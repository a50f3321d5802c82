#include "transition_sums.h"

#include <algorithm>
#include <cstring>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "transition_sums.cc"
// Each header needs the previous one. clang-format would sort them.
// clang-format off
#include "hwy/foreach_target.h"  // recompiles this file for each instruction set
#include "hwy/highway.h"
#include "hwy/contrib/math/math-inl.h"
// clang-format on
HWY_BEFORE_NAMESPACE();
namespace dfr::control::internal::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using Doubles = hn::CappedTag<double, kWidth>;
using Floats = hn::CappedTag<float, kPadding>;
using Row = hn::CappedTag<float, kWidth>;

// Computes the squared distances from z to kCount vectors of points, from row `i` on.
template <std::size_t kCount>
HWY_INLINE void DistancesFrom(std::size_t i, const float* points, std::size_t column_stride,
                              std::size_t dim, const float* z, hn::Vec<Floats>* sum) {
  constexpr Floats d;
  HWY_UNROLL(4)
  for (std::size_t j = 0; j < kCount; ++j) sum[j] = hn::Zero(d);
  const float* column = points + i;
  for (std::size_t k = 0; k < dim; ++k, column += column_stride) {
    const auto at = hn::Set(d, z[k]);
    HWY_UNROLL(4)
    for (std::size_t j = 0; j < kCount; ++j) {
      const auto difference = hn::Sub(hn::LoadU(d, column + j * hn::MaxLanes(d)), at);
      sum[j] = hn::MulAdd(difference, difference, sum[j]);
    }
  }
}

// Vectorised over rows, including the padding after them.
float Distances(const float* points, std::size_t column_stride, std::size_t dim, const float* z,
                std::size_t rows, float* distances) {
  constexpr Floats d;
  constexpr std::size_t kLanes = hn::MaxLanes(d);
  constexpr std::size_t kTogether = 4;
  const auto infinity = hn::Set(d, std::numeric_limits<float>::infinity());
  auto total = hn::Zero(d);
  auto least = infinity;
  std::size_t i = 0;
  for (; i + kTogether * kLanes <= rows; i += kTogether * kLanes) {
    hn::Vec<Floats> sum[kTogether];
    DistancesFrom<kTogether>(i, points, column_stride, dim, z, sum);
    HWY_UNROLL(4)
    for (std::size_t j = 0; j < kTogether; ++j) {
      hn::StoreU(sum[j], d, distances + i + j * kLanes);
      total = hn::Add(total, sum[j]);
      least = hn::Min(least, sum[j]);
    }
  }
  for (; i < rows; i += kLanes) {
    hn::Vec<Floats> sum[1];
    DistancesFrom<1>(i, points, column_stride, dim, z, sum);
    hn::StoreU(sum[0], d, distances + i);
    const auto row = hn::FirstN(d, rows - i);
    total = hn::Add(total, hn::IfThenElseZero(row, sum[0]));
    least = hn::Min(least, hn::IfThenElse(row, sum[0], infinity));
  }
  const float all = hn::GetLane(hn::SumOfLanes(d, total));
  return all < std::numeric_limits<float>::infinity() ? hn::GetLane(hn::MinOfLanes(d, least))
                                                      : std::numeric_limits<float>::quiet_NaN();
}

// Computes in double, because exponentials of float vectors differ between processors by more than
// the later rounding to float.
double WeightsOf(const float* distances, const std::int32_t* indices, std::size_t count,
                 float least, double scale, double floor, double* weights) {
  constexpr Doubles d;
  constexpr std::size_t kLanes = hn::MaxLanes(d);
  const hn::Rebind<float, Doubles> narrow;
  const hn::Rebind<std::int32_t, Doubles> index;
  const auto by = hn::Set(d, -scale);
  const auto from = hn::Set(d, static_cast<double>(least));
  const auto more = hn::Set(d, floor);
  const auto weigh = [&](std::size_t i) HWY_ATTR {
    const auto distance =
        hn::PromoteTo(d, hn::GatherIndex(narrow, distances, hn::LoadU(index, indices + i)));
    const auto weight = hn::Exp(d, hn::Mul(by, hn::Sub(distance, from)));
    hn::StoreU(hn::Add(weight, more), d, weights + i);
  };
  double sum = 0.0;
  std::size_t i = 0;
  for (; i + kLanes <= count; i += kLanes) {
    weigh(i);
    HWY_UNROLL(8)
    for (std::size_t k = 0; k < kLanes; ++k) sum += weights[i + k];
  }
  if (i < count) weigh(i);
  for (; i < count; ++i) sum += weights[i];
  return sum;
}

// Counts the distances of at most `bound`. Ignores the padding after the rows.
HWY_INLINE std::size_t CountAtMost(const float* distances, std::size_t rows, float bound) {
  constexpr Floats d;
  constexpr std::size_t kLanes = hn::MaxLanes(d);
  const auto most = hn::Set(d, bound);
  std::size_t count = 0;
  std::size_t i = 0;
  for (; i + 4 * kLanes <= rows; i += 4 * kLanes) {
    HWY_UNROLL(4)
    for (std::size_t k = 0; k < 4; ++k) {
      count += hn::CountTrue(d, hn::Le(hn::LoadU(d, distances + i + k * kLanes), most));
    }
  }
  for (; i + kLanes <= rows; i += kLanes) {
    count += hn::CountTrue(d, hn::Le(hn::LoadU(d, distances + i), most));
  }
  for (; i < rows; ++i) count += distances[i] <= bound ? 1 : 0;
  return count;
}

// Non-negative floats have the same order as their bits.
float FloatOf(std::uint32_t bits) {
  float value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

std::uint32_t BitsOf(float value) {
  std::uint32_t bits;
  std::memcpy(&bits, &value, sizeof bits);
  return bits;
}

// Copies the distances in [low, high] to `between` and returns their number. Used only if the
// processor can compress vectors.
constexpr bool kCompresses = HWY_TARGET <= HWY_AVX3;
constexpr std::size_t kMostBetween = 128;
HWY_INLINE std::size_t Between(const float* distances, std::size_t rows, float low, float high,
                               float* between) {
  constexpr Floats d;
  const std::size_t lanes = hn::Lanes(d);
  std::size_t size = 0;
  std::size_t i = 0;
  for (; i + lanes <= rows; i += lanes) {
    const auto some = hn::LoadU(d, distances + i);
    const auto kept = hn::And(hn::Ge(some, hn::Set(d, low)), hn::Le(some, hn::Set(d, high)));
    hn::StoreU(hn::Compress(some, kept), d, between + size);
    size += hn::CountTrue(d, kept);
  }
  for (; i < rows; ++i) {
    if (distances[i] >= low && distances[i] <= high) between[size++] = distances[i];
  }
  return size;
}

void NearestOf(const float* distances, std::size_t rows, std::size_t count, std::int32_t* indices) {
  if (count == rows) {
    for (std::size_t k = 0; k < rows; ++k) indices[k] = static_cast<std::int32_t>(k);
    return;
  }
  const Floats d;
  const std::size_t lanes = hn::Lanes(d);
  float least = distances[0];
  float most = distances[0];
  std::size_t i = 0;
  if (lanes <= rows) {
    auto leasts = hn::LoadU(d, distances);
    auto mosts = leasts;
    for (i = lanes; i + lanes <= rows; i += lanes) {
      const auto some = hn::LoadU(d, distances + i);
      leasts = hn::Min(leasts, some);
      mosts = hn::Max(mosts, some);
    }
    least = hn::GetLane(hn::MinOfLanes(d, leasts));
    most = hn::GetLane(hn::MaxOfLanes(d, mosts));
  }
  for (; i < rows; ++i) {
    least = std::min(least, distances[i]);
    most = std::max(most, distances[i]);
  }
  // Bisects for a bound that exactly `count` distances do not exceed. If equal distances prevent
  // this, finds the smallest bound that more distances do not exceed. Once few distances lie
  // between `low` and `high`, only these are counted.
  float between[kMostBetween + hn::MaxLanes(d)];
  const float* candidates = distances;
  std::size_t size = rows;
  struct {
    std::size_t below;    // Number of distances below `low`.
    std::size_t at_most;  // Number of distances up to `high`.
  } counted = {0, rows};
  std::uint32_t low = BitsOf(least);
  std::uint32_t high = BitsOf(most);
  std::uint32_t bound = high;
  std::size_t left_out = 0;  // Number of distances below all candidates.
  while (low < high) {
    if (kCompresses && candidates == distances && counted.at_most - counted.below <= kMostBetween) {
      size = Between(distances, rows, FloatOf(low), FloatOf(high), between);
      candidates = between;
      left_out = counted.below;
    }
    const std::uint32_t middle = low + (high - low) / 2;
    const std::size_t within = left_out + CountAtMost(candidates, size, FloatOf(middle));
    if (within >= count) {
      high = bound = middle;
      counted.at_most = within;
      if (within == count) break;
    } else {
      low = middle + 1;
      counted.below = within;
    }
  }
  const float farthest = FloatOf(bound);
  std::size_t placed = 0;
  i = 0;
  // Few distances are below `farthest`.
  for (; i + lanes <= rows; i += lanes) {
    std::uint64_t nearer = 0;
    hn::StoreMaskBits(d, hn::Lt(hn::LoadU(d, distances + i), hn::Set(d, farthest)),
                      reinterpret_cast<std::uint8_t*>(&nearer));
    for (; nearer != 0; nearer &= nearer - 1) {
      indices[placed++] = static_cast<std::int32_t>(i + hwy::Num0BitsBelowLS1Bit_Nonzero64(nearer));
    }
  }
  for (; i < rows; ++i) {
    indices[placed] = static_cast<std::int32_t>(i);
    placed += distances[i] < farthest ? 1 : 0;
  }
  for (i = 0; placed < count; ++i) {
    if (distances[i] == farthest) indices[placed++] = static_cast<std::int32_t>(i);
  }
}

// Adds left' right to kRows x kColumns vectors of sums, which stay in registers and keep the
// multipliers busy. An entry of `left` is loaded once for all columns.
template <std::size_t kRows, std::size_t kColumns, class D>
HWY_INLINE void AddVectors(D d, const float* left, std::size_t left_stride, const float* right,
                           std::size_t right_stride, std::size_t rows, float* sums,
                           std::size_t sums_stride) {
  hn::Vec<D> sum[kRows][kColumns];
  HWY_UNROLL(8)
  for (std::size_t r = 0; r < kRows; ++r) {
    HWY_UNROLL(3)
    for (std::size_t c = 0; c < kColumns; ++c) {
      sum[r][c] = hn::LoadU(d, sums + r * sums_stride + c * hn::MaxLanes(d));
    }
  }
  for (std::size_t i = 0; i < rows; ++i, left += left_stride, right += right_stride) {
    hn::Vec<D> x[kColumns];
    HWY_UNROLL(3)
    for (std::size_t c = 0; c < kColumns; ++c) x[c] = hn::LoadU(d, right + c * hn::MaxLanes(d));
    HWY_UNROLL(8)
    for (std::size_t r = 0; r < kRows; ++r) {
      const auto y = hn::Set(d, left[r]);
      HWY_UNROLL(3)
      for (std::size_t c = 0; c < kColumns; ++c) sum[r][c] = hn::MulAdd(y, x[c], sum[r][c]);
    }
  }
  HWY_UNROLL(8)
  for (std::size_t r = 0; r < kRows; ++r) {
    HWY_UNROLL(3)
    for (std::size_t c = 0; c < kColumns; ++c) {
      hn::StoreU(sum[r][c], d, sums + r * sums_stride + c * hn::MaxLanes(d));
    }
  }
}

// Same as AddVectors() for kWidth rows and two vectors, which may differ in size. Needs 32
// registers.
template <class First, class Second>
HWY_INLINE void AddPair(First d, Second e, const float* left, std::size_t left_stride,
                        const float* right, std::size_t right_stride, std::size_t rows, float* sums,
                        std::size_t sums_stride) {
  hn::Vec<First> sum[kWidth];
  hn::Vec<Second> next[kWidth];
  HWY_UNROLL(8)
  for (std::size_t r = 0; r < kWidth; ++r) {
    sum[r] = hn::LoadU(d, sums + r * sums_stride);
    next[r] = hn::LoadU(e, sums + r * sums_stride + hn::MaxLanes(d));
  }
  for (std::size_t i = 0; i < rows; ++i, left += left_stride, right += right_stride) {
    const auto x = hn::LoadU(d, right);
    const auto y = hn::LoadU(e, right + hn::MaxLanes(d));
    HWY_UNROLL(8)
    for (std::size_t r = 0; r < kWidth; ++r) {
      sum[r] = hn::MulAdd(hn::Set(d, left[r]), x, sum[r]);
      next[r] = hn::MulAdd(hn::Set(e, left[r]), y, next[r]);
    }
  }
  HWY_UNROLL(8)
  for (std::size_t r = 0; r < kWidth; ++r) {
    hn::StoreU(sum[r], d, sums + r * sums_stride);
    hn::StoreU(next[r], e, sums + r * sums_stride + hn::MaxLanes(d));
  }
}

// Adds left' right of a tile, whose left rows are contiguous.
HWY_INLINE void AddProduct(const float* left, std::size_t n_left, const float* right,
                           std::size_t right_stride, std::size_t n_right, std::size_t rows,
                           float* sums, std::size_t sums_stride) {
  constexpr Floats d;
  constexpr Row e;
  constexpr std::size_t kLanes = hn::MaxLanes(d);
  for (std::size_t row = 0; row < n_left; row += kWidth) {
    std::size_t column = 0;
    const float* a = left + row;
    float* out = sums + row * sums_stride;
#if HWY_TARGET <= HWY_AVX3
    for (; column + 2 * kLanes <= n_right; column += 2 * kLanes) {
      AddPair(d, d, a, n_left, right + column, right_stride, rows, out + column, sums_stride);
    }
    if (column + kLanes + kWidth <= n_right) {
      AddPair(d, e, a, n_left, right + column, right_stride, rows, out + column, sums_stride);
      column += kLanes + kWidth;
    }
#else
    for (; column + 3 * kLanes <= n_right; column += 3 * kLanes) {
      AddVectors<4, 3>(d, a, n_left, right + column, right_stride, rows, out + column, sums_stride);
      AddVectors<4, 3>(d, a + 4, n_left, right + column, right_stride, rows,
                       out + 4 * sums_stride + column, sums_stride);
    }
#endif
    for (; column + kLanes <= n_right; column += kLanes) {
      AddVectors<8, 1>(d, a, n_left, right + column, right_stride, rows, out + column, sums_stride);
    }
    for (; column < n_right; column += hn::MaxLanes(e)) {
      AddVectors<8, 1>(e, a, n_left, right + column, right_stride, rows, out + column, sums_stride);
    }
  }
}

// Sets left[k] = float(weight) row[k].
HWY_INLINE void Scale(double weight, const float* row, std::size_t n_left, float* left) {
  constexpr Row d;
  const auto by = hn::Set(d, static_cast<float>(weight));
  for (std::size_t k = 0; k < n_left; k += hn::MaxLanes(d)) {
    hn::StoreU(hn::Mul(by, hn::LoadU(d, row + k)), d, left + k);
  }
}

void Clear(std::size_t n_left, std::size_t n_right, float* sums, std::size_t sums_stride) {
  for (std::size_t row = 0; row < n_left; ++row) {
    std::fill_n(sums + row * sums_stride, n_right, 0.0F);
  }
}

void SumsOf(const float* left, std::size_t n_left, const float* right, std::size_t n_right,
            std::size_t stride, const double* weights, double factor, std::size_t count,
            float* tile, float* sums, std::size_t sums_stride) {
  Clear(n_left, n_right, sums, sums_stride);
  for (std::size_t first = 0; first < count; first += kTile) {
    const std::size_t rows = std::min(kTile, count - first);
    for (std::size_t i = 0; i < rows; ++i, left += stride) {
      Scale(factor * weights[first + i], left, n_left, tile + i * n_left);
    }
    AddProduct(tile, n_left, right, stride, n_right, rows, sums, sums_stride);
    right += rows * stride;
  }
}

void SumsAbout(const float* z, const float* rows, std::size_t width, const std::int32_t* indices,
               const double* weights, double factor, std::size_t count, std::size_t n_left,
               float* tile, float* sums) {
  constexpr Row d;
  Clear(n_left, width, sums, width);
  float* const left = tile + kTile * width;
  for (std::size_t first = 0; first < count; first += kTile) {
    const std::size_t size = std::min(kTile, count - first);
    float* right = tile;
    for (std::size_t i = 0; i < size; ++i, right += width) {
      const float* row = rows + static_cast<std::size_t>(indices[first + i]) * width;
      for (std::size_t k = 0; k < width; k += hn::MaxLanes(d)) {
        hn::StoreU(hn::Sub(hn::LoadU(d, row + k), hn::LoadU(d, z + k)), d, right + k);
      }
      Scale(factor * weights[first + i], right, n_left, left + i * n_left);
    }
    AddProduct(left, n_left, tile, width, width, size, sums, width);
  }
}

}  // namespace dfr::control::internal::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dfr::control::internal {

HWY_EXPORT(Distances);
HWY_EXPORT(WeightsOf);
HWY_EXPORT(NearestOf);
HWY_EXPORT(SumsOf);
HWY_EXPORT(SumsAbout);

float SquaredDistances(const float* points, std::size_t column_stride, std::size_t dim,
                       const float* z, std::size_t rows, float* distances) noexcept {
  return HWY_DYNAMIC_DISPATCH(Distances)(points, column_stride, dim, z, rows, distances);
}

double Weights(const float* distances, const std::int32_t* indices, std::size_t count, float least,
               double scale, double floor, double* weights) noexcept {
  return HWY_DYNAMIC_DISPATCH(WeightsOf)(distances, indices, count, least, scale, floor, weights);
}

void Nearest(const float* distances, std::size_t rows, std::size_t count,
             std::int32_t* indices) noexcept {
  HWY_DYNAMIC_DISPATCH(NearestOf)(distances, rows, count, indices);
}

void WeightedSums(const float* left, std::size_t n_left, const float* right, std::size_t n_right,
                  std::size_t stride, const double* weights, double factor, std::size_t count,
                  float* tile, float* sums, std::size_t sums_stride) noexcept {
  HWY_DYNAMIC_DISPATCH(SumsOf)
  (left, n_left, right, n_right, stride, weights, factor, count, tile, sums, sums_stride);
}

void WeightedSumsAbout(const float* z, const float* rows, std::size_t width,
                       const std::int32_t* indices, const double* weights, double factor,
                       std::size_t count, std::size_t n_left, float* tile, float* sums) noexcept {
  HWY_DYNAMIC_DISPATCH(SumsAbout)
  (z, rows, width, indices, weights, factor, count, n_left, tile, sums);
}

}  // namespace dfr::control::internal
#endif  // HWY_ONCE
