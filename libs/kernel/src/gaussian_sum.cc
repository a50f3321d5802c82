#include "gaussian_sum.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gaussian_sum.cc"
#include "hwy/foreach_target.h"  // recompiles this file for each instruction set
#include "hwy/highway.h"
HWY_BEFORE_NAMESPACE();
namespace dfr::kernel::internal::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// 2^f on [0, 1) with relative error 8.3e-8 and 2.3e-16 (Remez, constant term 1 so that k(x, x) =
// 1).
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

// 2^e for e <= 1024, zero below the smallest normal number.
template <class D, class V>
HWY_INLINE V Exp2(D d, V e) {
#if HWY_TARGET <= HWY_AVX3
  // Two instructions that Highway has no name for: e - floor(e) and p * 2^floor(e).
  constexpr int kFloorNoException = 0x09;
  if constexpr (sizeof(hn::TFromD<D>) == 4) {
    const V f{_mm512_reduce_ps(e.raw, kFloorNoException)};
    return V{_mm512_scalef_ps(Exp2OfFraction(d, f).raw, e.raw)};
  } else {
    const V f{_mm512_reduce_pd(e.raw, kFloorNoException)};
    return V{_mm512_scalef_pd(Exp2OfFraction(d, f).raw, e.raw)};
  }
#else
  constexpr bool kSingle = sizeof(hn::TFromD<D>) == 4;
  using T = hn::TFromD<D>;
  const hn::RebindToSigned<D> di;
  // At the clamp the fraction is 0 and the exponent field becomes 0: exactly zero.
  e = hn::Max(e, hn::Set(d, kSingle ? T(-127) : T(-1023)));
  const V n = hn::Floor(e);
  const V p = Exp2OfFraction(d, hn::Sub(e, n));
  // 1.5 * 2^mantissa bits puts n into the low bits of the mantissa.
  const V shifted = hn::Add(n, hn::Set(d, kSingle ? T(12582912.0) : T(6755399441055744.0)));
  constexpr int kMantissaBits = kSingle ? 23 : 52;
  return hn::BitCast(
      d, hn::Add(hn::BitCast(di, p), hn::ShiftLeft<kMantissaBits>(hn::BitCast(di, shifted))));
#endif
}

template <typename T>
using Tag = hn::CappedTag<T, GaussianTerms<T>::kLanes>;
template <typename T>
constexpr std::size_t VectorsPerBlock() {
  return GaussianTerms<T>::kLanes / hn::MaxLanes(Tag<T>());
}
// Vectors evaluated together: enough independent chains to hide the latency of an FMA. With 16
// registers more than four spill.
constexpr std::size_t kTogether = HWY_TARGET <= HWY_AVX3 ? 8 : 4;

// Terms of kVectors successive vectors of which the first begins at `block`, each handed to
// `use(index, term)`.
template <std::size_t kVectors, typename T, class Use>
HWY_INLINE void ForTerms(const T* HWY_RESTRICT block, std::size_t dim, const T* HWY_RESTRICT x,
                         Use&& use) {
  using D = Tag<T>;
  constexpr D d;
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  constexpr std::size_t kPerBlock = VectorsPerBlock<T>();
  const std::size_t stride = (dim + 1) * kLanes;
  const auto at = [&](std::size_t j, std::size_t row) HWY_ATTR {
    return hn::Load(
        d, block + j / kPerBlock * stride + row * kLanes + j % kPerBlock * hn::MaxLanes(d));
  };
  hn::Vec<D> exponent[kVectors];
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
  HWY_UNROLL(8)
  for (std::size_t j = 0; j < kVectors; ++j) exponent[j] = Exp2(d, exponent[j]);
  HWY_UNROLL(8)
  for (std::size_t j = 0; j < kVectors; ++j) use(j, exponent[j]);
}

// All terms of num_blocks blocks, in groups of kTogether vectors and then one block at a time.
template <typename T, class Use>
HWY_INLINE void ForAllTerms(const T* HWY_RESTRICT data, std::size_t num_blocks, std::size_t dim,
                            const T* HWY_RESTRICT x, Use&& use) {
  constexpr std::size_t kPerBlock = VectorsPerBlock<T>();
  constexpr std::size_t kBlocks = std::max<std::size_t>(1, kTogether / kPerBlock);
  const std::size_t stride = (dim + 1) * GaussianTerms<T>::kLanes;
  std::size_t b = 0;
  for (; b + kBlocks <= num_blocks; b += kBlocks) {
    ForTerms<kBlocks * kPerBlock>(data + b * stride, dim, x,
                                  [&](std::size_t j, auto term)
                                      HWY_ATTR { use(b * kPerBlock + j, term); });
  }
  if constexpr (kBlocks > 4) {
    if (b + 4 <= num_blocks) {
      ForTerms<4 * kPerBlock>(data + b * stride, dim, x, [&](std::size_t j, auto term) HWY_ATTR {
        use(b * kPerBlock + j, term);
      });
      b += 4;
    }
  }
  if constexpr (kBlocks > 2) {
    if (b + 2 <= num_blocks) {
      ForTerms<2 * kPerBlock>(data + b * stride, dim, x, [&](std::size_t j, auto term) HWY_ATTR {
        use(b * kPerBlock + j, term);
      });
      b += 2;
    }
  }
  for (; b < num_blocks; ++b) {
    ForTerms<kPerBlock>(data + b * stride, dim, x,
                        [&](std::size_t j, auto term) HWY_ATTR { use(b * kPerBlock + j, term); });
  }
}

// Sums terms in two chains, the same ones however the terms are visited.
template <typename T>
struct Total {
  hn::Vec<Tag<T>> even;
  hn::Vec<Tag<T>> odd;

  // Spelled out: an implicit constructor would not be compiled for the instruction set.
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

template <typename T>
HWY_INLINE T Sum(const GaussianTerms<T>& terms, const T* HWY_RESTRICT x) {
  Total<T> total;
  ForAllTerms(terms.data.data(), terms.num_blocks, terms.dim, x,
              [&](std::size_t j, auto term) HWY_ATTR { total.Add(j, term); });
  return total.Value();
}

template <typename T>
HWY_INLINE void Row(const GaussianTerms<T>& terms, const T* HWY_RESTRICT x, T* HWY_RESTRICT row) {
  constexpr Tag<T> d;
  ForAllTerms(terms.data.data(), terms.num_blocks, terms.dim, x,
              [&](std::size_t j, auto term)
                  HWY_ATTR { hn::Store(term, d, row + j * hn::MaxLanes(d)); });
}

// Features summed together in the second pass: each loads the term once.
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
HWY_INLINE T SumShift(const GaussianTerms<T>& terms, const T* HWY_RESTRICT x,
                      T* HWY_RESTRICT shift) {
  constexpr Tag<T> d;
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  // Blocks whose terms fill 4 KiB; a multiple of every group, so that the sum equals Sum()'s.
  constexpr std::size_t kChunk = 4096 / kLanes / sizeof(T);
  alignas(64) T row[kChunk * kLanes];
  std::fill_n(shift, terms.dim, T{0});
  Total<T> total;
  for (std::size_t b = 0; b < terms.num_blocks; b += kChunk) {
    const std::size_t blocks = std::min(kChunk, terms.num_blocks - b);
    const T* data = terms.data.data() + b * (terms.dim + 1) * kLanes;
    ForAllTerms(data, blocks, terms.dim, x, [&](std::size_t j, auto term) HWY_ATTR {
      hn::Store(term, d, row + j * hn::MaxLanes(d));
      total.Add(j, term);
    });
    std::size_t k = 0;
    for (; k + kFeatures <= terms.dim; k += kFeatures) {
      AddShift<kFeatures>(data, row, blocks, terms.dim, k, x, shift);
    }
    for (; k < terms.dim; ++k) AddShift<1>(data, row, blocks, terms.dim, k, x, shift);
  }
  return total.Value();
}

double SumDouble(const GaussianTerms<double>& terms, const double* x) { return Sum(terms, x); }
float SumFloat(const GaussianTerms<float>& terms, const float* x) { return Sum(terms, x); }
void RowDouble(const GaussianTerms<double>& terms, const double* x, double* row) {
  Row(terms, x, row);
}
void RowFloat(const GaussianTerms<float>& terms, const float* x, float* row) { Row(terms, x, row); }
double SumShiftDouble(const GaussianTerms<double>& terms, const double* x, double* shift) {
  return SumShift(terms, x, shift);
}
float SumShiftFloat(const GaussianTerms<float>& terms, const float* x, float* shift) {
  return SumShift(terms, x, shift);
}

}  // namespace dfr::kernel::internal::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dfr::kernel::internal {

HWY_EXPORT(SumDouble);
HWY_EXPORT(SumFloat);
HWY_EXPORT(RowDouble);
HWY_EXPORT(RowFloat);
HWY_EXPORT(SumShiftDouble);
HWY_EXPORT(SumShiftFloat);

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
double GaussianSum(const GaussianTerms<double>& terms, const double* x) noexcept {
  return HWY_DYNAMIC_DISPATCH(SumDouble)(terms, x);
}
template <>
float GaussianSum(const GaussianTerms<float>& terms, const float* x) noexcept {
  return HWY_DYNAMIC_DISPATCH(SumFloat)(terms, x);
}
template <>
void GaussianRow(const GaussianTerms<double>& terms, const double* x, double* row) noexcept {
  HWY_DYNAMIC_DISPATCH(RowDouble)(terms, x, row);
}
template <>
void GaussianRow(const GaussianTerms<float>& terms, const float* x, float* row) noexcept {
  HWY_DYNAMIC_DISPATCH(RowFloat)(terms, x, row);
}
template <>
double GaussianSumShift(const GaussianTerms<double>& terms, const double* x,
                        double* shift) noexcept {
  return HWY_DYNAMIC_DISPATCH(SumShiftDouble)(terms, x, shift);
}
template <>
float GaussianSumShift(const GaussianTerms<float>& terms, const float* x, float* shift) noexcept {
  return HWY_DYNAMIC_DISPATCH(SumShiftFloat)(terms, x, shift);
}

std::vector<std::int64_t> SupportedTargets() { return hwy::SupportedAndGeneratedTargets(); }

const char* TargetName(std::int64_t target) { return hwy::TargetName(target); }

void ForceTarget(std::int64_t target) {
  hwy::SetSupportedTargetsForTest(target);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
}

}  // namespace dfr::kernel::internal
#endif  // HWY_ONCE
