#include "mlp/dense_kernels.h"

#include <cstdint>

// The tiles below are arrays of vectors, which targets with variable vector length do not support.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "mlp/dense_kernels.cc"
#include "hwy/foreach_target.h"  // recompiles this file for each instruction set
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace dfr::imitation::internal::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using Tag = hn::ScalableTag<double>;
using Vector = hn::Vec<Tag>;

// A tile of kTileRows x kTileVectors accumulators, kTileVectors vectors of B and one of A fill the
// register file: 29 of 32 registers with AVX-512, 15 of 16 otherwise.
constexpr int kTileRows = 6;
#if HWY_TARGET <= HWY_AVX3  // newer instruction sets have smaller numbers
constexpr int kTileVectors = 4;
#else
constexpr int kTileVectors = 2;
#endif

// Loads the first `count` lanes, at least one and not all. On instruction sets without masks,
// Highway's masked loads access the memory of the other lanes. Vectors have two lanes there, so
// count is one.
#if HWY_TARGET <= HWY_AVX2
HWY_INLINE Vector LoadFirst(const double* from, std::size_t count) {
  return hn::MaskedLoad(hn::FirstN(Tag(), count), Tag(), from);
}
HWY_INLINE void StoreFirst(Vector v, double* to, std::size_t count) {
  hn::BlendedStore(v, hn::FirstN(Tag(), count), Tag(), to);
}
#else
static_assert(hn::MaxLanes(Tag()) <= 2);
HWY_INLINE Vector LoadFirst(const double* from, std::size_t /*count*/) {
  return hn::Set(Tag(), *from);
}
HWY_INLINE void StoreFirst(Vector v, double* to, std::size_t /*count*/) { *to = hn::GetLane(v); }
#endif

template <bool kPartial>
HWY_INLINE Vector Load(const double* from, std::size_t count) {
  if constexpr (kPartial) return LoadFirst(from, count);
  return hn::LoadU(Tag(), from);
}

template <bool kPartial>
HWY_INLINE void Store(Vector v, double* to, std::size_t count) {
  if constexpr (kPartial) {
    StoreFirst(v, to, count);
  } else {
    hn::StoreU(v, Tag(), to);
  }
}

// Computes C's tile at (i, j). `lanes` is the number of columns of a tile of one partial vector.
template <int kRows, int kVectors, bool kPartial>
HWY_INLINE void Tile(const Product& p, int i, int j, std::size_t lanes) {
  static_assert(!kPartial || kVectors == 1);
  constexpr int kLanes = static_cast<int>(hn::MaxLanes(Tag()));

  double* const c = p.c + i * p.c_row + j;
  Vector sum[kRows][kVectors];
#pragma GCC unroll 8
  for (int r = 0; r < kRows; ++r) {
#pragma GCC unroll 8
    for (int v = 0; v < kVectors; ++v) {
      sum[r][v] = p.accumulate          ? Load<kPartial>(c + r * p.c_row + v * kLanes, lanes)
                  : (p.bias != nullptr) ? Load<kPartial>(p.bias + j + v * kLanes, lanes)
                                        : hn::Zero(Tag());
    }
  }
  const double* a = p.a + i * p.a_row;
  const double* b = p.b + j;
  const std::ptrdiff_t a_row = p.a_row;
  for (int k = 0; k < p.k; ++k, a += p.a_col, b += p.b_row) {
    Vector columns[kVectors];
#pragma GCC unroll 8
    for (int v = 0; v < kVectors; ++v) columns[v] = Load<kPartial>(b + v * kLanes, lanes);
#pragma GCC unroll 8
    for (int r = 0; r < kRows; ++r) {
      const Vector row = hn::Set(Tag(), a[r * a_row]);
#pragma GCC unroll 8
      for (int v = 0; v < kVectors; ++v) sum[r][v] = hn::MulAdd(row, columns[v], sum[r][v]);
    }
  }
#pragma GCC unroll 8
  for (int r = 0; r < kRows; ++r) {
#pragma GCC unroll 8
    for (int v = 0; v < kVectors; ++v) {
      Store<kPartial>(sum[r][v], c + r * p.c_row + v * kLanes, lanes);
    }
  }
}

template <int kVectors, bool kPartial>
HWY_INLINE void Columns(const Product& p, int j, std::size_t lanes) {
  int i = 0;
  for (; i + kTileRows <= p.m; i += kTileRows) Tile<kTileRows, kVectors, kPartial>(p, i, j, lanes);
  for (; i + 2 <= p.m; i += 2) Tile<2, kVectors, kPartial>(p, i, j, lanes);
  for (; i < p.m; ++i) Tile<1, kVectors, kPartial>(p, i, j, lanes);
}

void Multiply(const Product& p) {
  const int lanes = static_cast<int>(hn::Lanes(Tag()));
  const auto all = static_cast<std::size_t>(lanes);
  int j = 0;
  for (; j + kTileVectors * lanes <= p.n; j += kTileVectors * lanes) {
    Columns<kTileVectors, false>(p, j, all);
  }
  for (; j + lanes <= p.n; j += lanes) Columns<1, false>(p, j, all);
  if (j < p.n) Columns<1, true>(p, j, static_cast<std::size_t>(p.n - j));
}

// tanh(x) = e / (e + 2) with e = exp(2|x|) - 1, which keeps the relative accuracy at 0. With 2|x| =
// n ln 2 + r, e = 2^n (exp(r) - 1) + (2^n - 1). exp(r) - 1 is a Taylor series, whose 14th term is
// below 2e-17 of the first for |r| <= ln(2)/2.
HWY_INLINE Vector TanhOf(Vector x) {
  const Tag d;
  const hn::RebindToUnsigned<Tag> du;
  const Vector magnitude = hn::Abs(x);
  const Vector limit = hn::Set(d, 20.0);  // tanh is 1 from 19.1 on
  const Vector clamped = hn::IfThenElse(hn::Gt(magnitude, limit), limit, magnitude);  // NaN stays
  const Vector y = hn::Add(clamped, clamped);

  // Adding 1.5 * 2^52 rounds to an integer, which is then in the lowest bits.
  const Vector shift = hn::Set(d, 0x1.8p52);
  const Vector shifted = hn::MulAdd(y, hn::Set(d, 1.4426950408889634), shift);
  const Vector n = hn::Sub(shifted, shift);
  // ln 2 in two parts. The first has few enough bits for an exact product with n.
  const Vector r = hn::NegMulAdd(n, hn::Set(d, 0x1.a39ef35793c76p-33),
                                 hn::NegMulAdd(n, hn::Set(d, 0x1.62e42feep-1), y));
  const Vector power = hn::BitCast(
      d, hn::ShiftLeft<52>(hn::Add(hn::BitCast(du, shifted), hn::Set(du, std::uint64_t{1023}))));

  // sum of r^i / (i + 2)! for i = 0 ... 11, as even and odd halves to shorten the chain.
  const Vector r2 = hn::Mul(r, r);
  Vector even = hn::Set(d, 1.0 / 479001600.0);
  even = hn::MulAdd(even, r2, hn::Set(d, 1.0 / 3628800.0));
  even = hn::MulAdd(even, r2, hn::Set(d, 1.0 / 40320.0));
  even = hn::MulAdd(even, r2, hn::Set(d, 1.0 / 720.0));
  even = hn::MulAdd(even, r2, hn::Set(d, 1.0 / 24.0));
  even = hn::MulAdd(even, r2, hn::Set(d, 1.0 / 2.0));
  Vector odd = hn::Set(d, 1.0 / 6227020800.0);
  odd = hn::MulAdd(odd, r2, hn::Set(d, 1.0 / 39916800.0));
  odd = hn::MulAdd(odd, r2, hn::Set(d, 1.0 / 362880.0));
  odd = hn::MulAdd(odd, r2, hn::Set(d, 1.0 / 5040.0));
  odd = hn::MulAdd(odd, r2, hn::Set(d, 1.0 / 120.0));
  odd = hn::MulAdd(odd, r2, hn::Set(d, 1.0 / 6.0));
  const Vector expm1_r = hn::MulAdd(hn::MulAdd(odd, r, even), r2, r);

  const Vector e = hn::MulAdd(expm1_r, power, hn::Sub(power, hn::Set(d, 1.0)));
  return hn::CopySign(hn::Div(e, hn::Add(e, hn::Set(d, 2.0))), x);
}

void Tanh(double* values, std::size_t size) {
  const Tag d;
  const std::size_t lanes = hn::Lanes(d);
  std::size_t i = 0;
  for (; i + lanes <= size; i += lanes) hn::StoreU(TanhOf(hn::LoadU(d, values + i)), d, values + i);
  if (i < size) StoreFirst(TanhOf(LoadFirst(values + i, size - i)), values + i, size - i);
}

HWY_INLINE Vector TimesSlope(Vector gradient, Vector activation) {
  return hn::NegMulAdd(hn::Mul(gradient, activation), activation, gradient);
}

void TimesTanhSlope(double* gradients, const double* activations, std::size_t size) {
  const Tag d;
  const std::size_t lanes = hn::Lanes(d);
  std::size_t i = 0;
  for (; i + lanes <= size; i += lanes) {
    hn::StoreU(TimesSlope(hn::LoadU(d, gradients + i), hn::LoadU(d, activations + i)), d,
               gradients + i);
  }
  if (i < size) {
    const std::size_t rest = size - i;
    StoreFirst(TimesSlope(LoadFirst(gradients + i, rest), LoadFirst(activations + i, rest)),
               gradients + i, rest);
  }
}

}  // namespace dfr::imitation::internal::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dfr::imitation::internal {
namespace {
HWY_EXPORT(Multiply);
HWY_EXPORT(Tanh);
HWY_EXPORT(TimesTanhSlope);
}  // namespace

void Multiply(const Product& product) noexcept { HWY_DYNAMIC_DISPATCH(Multiply)(product); }

void Tanh(double* values, std::size_t size) noexcept { HWY_DYNAMIC_DISPATCH(Tanh)(values, size); }

void TimesTanhSlope(double* gradients, const double* activations, std::size_t size) noexcept {
  HWY_DYNAMIC_DISPATCH(TimesTanhSlope)(gradients, activations, size);
}

}  // namespace dfr::imitation::internal
#endif  // HWY_ONCE
