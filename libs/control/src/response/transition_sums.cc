#include "transition_sums.h"

#include <algorithm>
#include <cstring>

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

// Vectorized over rows, including the padding behind them.
void Distances(const float* points, std::size_t column_stride, std::size_t dim, const float* z,
               std::size_t rows, float* distances) {
  const Floats d;
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t i = 0; i < rows; i += lanes) {
    auto sum = hn::Zero(d);
    const float* column = points + i;
    for (std::size_t k = 0; k < dim; ++k, column += column_stride) {
      const auto difference = hn::Sub(hn::LoadU(d, column), hn::Set(d, z[k]));
      sum = hn::MulAdd(difference, difference, sum);
    }
    hn::StoreU(sum, d, distances + i);
  }
}

// In double: exponentials of floats differ between processors by more than all later rounding.
void WeightsOf(const float* distances, std::size_t rows, float least, double scale,
               double* weights) {
  const Doubles d;
  const hn::Rebind<float, decltype(d)> narrow;
  const std::size_t lanes = hn::Lanes(d);
  const auto by = hn::Set(d, -scale);
  const auto from = hn::Set(d, static_cast<double>(least));
  for (std::size_t i = 0; i < rows; i += lanes) {
    const auto distance = hn::PromoteTo(d, hn::LoadU(narrow, distances + i));
    hn::StoreU(hn::Exp(d, hn::Mul(by, hn::Sub(distance, from))), d, weights + i);
  }
}

// Counts the distances of at most `bound`. Ignores the padding behind the rows.
HWY_INLINE std::size_t CountAtMost(const float* distances, std::size_t rows, float bound) {
  const Floats d;
  const std::size_t lanes = hn::Lanes(d);
  const auto most = hn::Set(d, bound);
  const hn::RebindToSigned<decltype(d)> di;
  auto counts = hn::Zero(di);
  std::size_t i = 0;
  for (; i + lanes <= rows; i += lanes) {
    const auto within = hn::RebindMask(di, hn::Le(hn::LoadU(d, distances + i), most));
    counts = hn::Sub(counts, hn::VecFromMask(di, within));  // true is -1
  }
  auto count = static_cast<std::size_t>(hn::GetLane(hn::SumOfLanes(di, counts)));
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
  // Bisects for the smallest bound of at least `count` distances. Stops at one of exactly `count`.
  std::uint32_t low = BitsOf(least);
  std::uint32_t high = BitsOf(most);
  std::uint32_t bound = high;
  while (low < high) {
    const std::uint32_t middle = low + (high - low) / 2;
    const std::size_t within = CountAtMost(distances, rows, FloatOf(middle));
    if (within >= count) {
      high = bound = middle;
      if (within == count) break;
    } else {
      low = middle + 1;
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

void DifferencesOf(const float* rows, std::size_t width, const std::int32_t* indices,
                   std::size_t count, const float* z, float* right) {
  const Row d;
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t i = 0; i < count; ++i, right += width) {
    const float* row = rows + static_cast<std::size_t>(indices[i]) * width;
    for (std::size_t k = 0; k < width; k += lanes) {
      hn::StoreU(hn::Sub(hn::LoadU(d, row + k), hn::LoadU(d, z + k)), d, right + k);
    }
  }
}

void Scale(const float* rows, std::size_t row_stride, const std::int32_t* indices,
           std::size_t count, const double* weights, double factor, std::size_t n_left, float* left,
           std::size_t left_stride) {
  const Row d;
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t i = 0; i < count; ++i, rows += row_stride, left += left_stride) {
    const auto weight = hn::Set(d, static_cast<float>(factor * weights[indices[i]]));
    for (std::size_t k = 0; k < n_left; k += lanes) {
      hn::StoreU(hn::Mul(weight, hn::LoadU(d, rows + k)), d, left + k);
    }
  }
}

// Sums the columns from `column` on that fit into a vector. kWidth rows of sums at a time stay in
// registers and keep the multipliers busy.
template <class D>
HWY_INLINE void Columns(D d, const float* left, std::size_t left_stride, std::size_t n_left,
                        const float* right, std::size_t right_stride, std::size_t rows, float* sums,
                        std::size_t sums_stride) {
  using V = hn::Vec<D>;
  for (std::size_t first = 0; first < n_left; first += kWidth) {
    V s0 = hn::Zero(d);
    V s1 = s0;
    V s2 = s0;
    V s3 = s0;
    V s4 = s0;
    V s5 = s0;
    V s6 = s0;
    V s7 = s0;
    const float* a = left + first;
    const float* b = right;
    for (std::size_t i = 0; i < rows; ++i, a += left_stride, b += right_stride) {
      const V x = hn::LoadU(d, b);
      s0 = hn::MulAdd(hn::Set(d, a[0]), x, s0);
      s1 = hn::MulAdd(hn::Set(d, a[1]), x, s1);
      s2 = hn::MulAdd(hn::Set(d, a[2]), x, s2);
      s3 = hn::MulAdd(hn::Set(d, a[3]), x, s3);
      s4 = hn::MulAdd(hn::Set(d, a[4]), x, s4);
      s5 = hn::MulAdd(hn::Set(d, a[5]), x, s5);
      s6 = hn::MulAdd(hn::Set(d, a[6]), x, s6);
      s7 = hn::MulAdd(hn::Set(d, a[7]), x, s7);
    }
    float* out = sums + first * sums_stride;
    hn::StoreU(s0, d, out);
    hn::StoreU(s1, d, out + sums_stride);
    hn::StoreU(s2, d, out + 2 * sums_stride);
    hn::StoreU(s3, d, out + 3 * sums_stride);
    hn::StoreU(s4, d, out + 4 * sums_stride);
    hn::StoreU(s5, d, out + 5 * sums_stride);
    hn::StoreU(s6, d, out + 6 * sums_stride);
    hn::StoreU(s7, d, out + 7 * sums_stride);
  }
}

// Sums three vectors of columns from `column` on, four rows at a time: sixteen registers hold the
// sums and factors, and an entry of `left` is loaded once for three products.
template <class D>
HWY_INLINE void ThreeColumns(D d, const float* left, std::size_t left_stride, std::size_t n_left,
                             const float* right, std::size_t right_stride, std::size_t rows,
                             float* sums, std::size_t sums_stride) {
  using V = hn::Vec<D>;
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t first = 0; first < n_left; first += 4) {
    V s00 = hn::Zero(d), s01 = s00, s02 = s00;
    V s10 = s00, s11 = s00, s12 = s00;
    V s20 = s00, s21 = s00, s22 = s00;
    V s30 = s00, s31 = s00, s32 = s00;
    const float* a = left + first;
    const float* b = right;
    for (std::size_t i = 0; i < rows; ++i, a += left_stride, b += right_stride) {
      const V x0 = hn::LoadU(d, b);
      const V x1 = hn::LoadU(d, b + lanes);
      const V x2 = hn::LoadU(d, b + 2 * lanes);
      V y = hn::Set(d, a[0]);
      s00 = hn::MulAdd(y, x0, s00);
      s01 = hn::MulAdd(y, x1, s01);
      s02 = hn::MulAdd(y, x2, s02);
      y = hn::Set(d, a[1]);
      s10 = hn::MulAdd(y, x0, s10);
      s11 = hn::MulAdd(y, x1, s11);
      s12 = hn::MulAdd(y, x2, s12);
      y = hn::Set(d, a[2]);
      s20 = hn::MulAdd(y, x0, s20);
      s21 = hn::MulAdd(y, x1, s21);
      s22 = hn::MulAdd(y, x2, s22);
      y = hn::Set(d, a[3]);
      s30 = hn::MulAdd(y, x0, s30);
      s31 = hn::MulAdd(y, x1, s31);
      s32 = hn::MulAdd(y, x2, s32);
    }
    float* out = sums + first * sums_stride;
    const auto store = [&](V c0, V c1, V c2) HWY_ATTR {
      hn::StoreU(c0, d, out);
      hn::StoreU(c1, d, out + lanes);
      hn::StoreU(c2, d, out + 2 * lanes);
      out += sums_stride;
    };
    store(s00, s01, s02);
    store(s10, s11, s12);
    store(s20, s21, s22);
    store(s30, s31, s32);
  }
}

void Product(const float* left, std::size_t left_stride, std::size_t n_left, const float* right,
             std::size_t right_stride, std::size_t n_right, std::size_t rows, float* sums,
             std::size_t sums_stride) {
  std::size_t column = 0;
  const auto columns = [&](auto d) HWY_ATTR {
    for (; column + 3 * hn::Lanes(d) <= n_right; column += 3 * hn::Lanes(d)) {
      ThreeColumns(d, left, left_stride, n_left, right + column, right_stride, rows, sums + column,
                   sums_stride);
    }
    for (; column + hn::Lanes(d) <= n_right; column += hn::Lanes(d)) {
      Columns(d, left, left_stride, n_left, right + column, right_stride, rows, sums + column,
              sums_stride);
    }
  };
  columns(Floats());
  columns(Row());
}

}  // namespace dfr::control::internal::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dfr::control::internal {

HWY_EXPORT(Distances);
HWY_EXPORT(WeightsOf);
HWY_EXPORT(NearestOf);
HWY_EXPORT(DifferencesOf);
HWY_EXPORT(Scale);
HWY_EXPORT(Product);

void SquaredDistances(const float* points, std::size_t column_stride, std::size_t dim,
                      const float* z, std::size_t rows, float* distances) noexcept {
  HWY_DYNAMIC_DISPATCH(Distances)(points, column_stride, dim, z, rows, distances);
}

void Weights(const float* distances, std::size_t rows, float least, double scale,
             double* weights) noexcept {
  HWY_DYNAMIC_DISPATCH(WeightsOf)(distances, rows, least, scale, weights);
}

void Nearest(const float* distances, std::size_t rows, std::size_t count,
             std::int32_t* indices) noexcept {
  HWY_DYNAMIC_DISPATCH(NearestOf)(distances, rows, count, indices);
}

void Differences(const float* rows, std::size_t width, const std::int32_t* indices,
                 std::size_t count, const float* z, float* right) noexcept {
  HWY_DYNAMIC_DISPATCH(DifferencesOf)(rows, width, indices, count, z, right);
}

void ScaleRows(const float* rows, std::size_t row_stride, const std::int32_t* indices,
               std::size_t count, const double* weights, double factor, std::size_t n_left,
               float* left, std::size_t left_stride) noexcept {
  HWY_DYNAMIC_DISPATCH(Scale)
  (rows, row_stride, indices, count, weights, factor, n_left, left, left_stride);
}

void TransposedProduct(const float* left, std::size_t left_stride, std::size_t n_left,
                       const float* right, std::size_t right_stride, std::size_t n_right,
                       std::size_t rows, float* sums, std::size_t sums_stride) noexcept {
  HWY_DYNAMIC_DISPATCH(Product)
  (left, left_stride, n_left, right, right_stride, n_right, rows, sums, sums_stride);
}

}  // namespace dfr::control::internal
#endif  // HWY_ONCE
