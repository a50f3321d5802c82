#include "smo_passes.h"

#include <cstdint>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "smo_passes.cc"
#include "hwy/foreach_target.h"  // recompiles this file for each instruction set
#include "hwy/highway.h"
HWY_BEFORE_NAMESPACE();
namespace dfr::kernel::internal::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

template <typename T>
using Tag = hn::CappedTag<T, 64 / sizeof(T)>;
template <typename T>
using IndexTag = hn::RebindToSigned<Tag<T>>;

// 1 / v, to 14 bits where an instruction defines them: the choice of a pair need not be exact, the
// step is.
template <class D, class V>
HWY_INLINE V RoughReciprocal(D d, V v) {
#if HWY_TARGET <= HWY_AVX3
  if constexpr (sizeof(hn::TFromD<D>) == 4) return hn::ApproximateReciprocal(v);
#endif
  return hn::Div(hn::Set(d, hn::TFromD<D>(1)), v);
}

// The first index at which `value` equals its extreme.
template <typename T, class V, class I>
HWY_INLINE std::size_t FirstAt(V value, T extreme, I index) {
  constexpr Tag<T> d;
  constexpr IndexTag<T> di;
  using Index = hn::TFromD<IndexTag<T>>;
  const auto none = hn::Set(di, std::numeric_limits<Index>::max());
  const auto here = hn::RebindMask(di, hn::Eq(value, hn::Set(d, extreme)));
  const auto least = hn::MinOfLanes(di, hn::IfThenElse(here, index, none));
  return static_cast<std::size_t>(hn::GetLane(least));
}

template <typename T>
std::size_t ChooseSecond(const T* HWY_RESTRICT row_i, const T* HWY_RESTRICT gradient,
                         const T* HWY_RESTRICT may_fall, T g_i, std::size_t count) {
  constexpr Tag<T> d;
  constexpr IndexTag<T> di;
  using Index = hn::TFromD<IndexTag<T>>;
  constexpr std::size_t kStep = hn::MaxLanes(d);
  const auto zero = hn::Zero(d);
  const auto two = hn::Set(d, T(2));
  const auto least_curvature = hn::Set(d, sizeof(T) == 4 ? T(1e-7) : T(1e-12));
  const auto base = hn::Set(d, g_i);
  auto best = zero;
  auto best_at = hn::Zero(di);
  auto index = hn::Iota(di, 0);
  for (std::size_t k = 0; k < count; k += kStep) {
    const auto fall = hn::Add(hn::Load(d, gradient + k), hn::Load(d, may_fall + k));
    const auto slope = hn::Max(hn::Sub(fall, base), zero);
    const auto curvature =
        hn::Max(hn::NegMulAdd(two, hn::Load(d, row_i + k), two), least_curvature);
    const auto decrease = hn::Mul(hn::Mul(slope, slope), RoughReciprocal(d, curvature));
    const auto better = hn::Gt(decrease, best);
    best = hn::Max(best, decrease);
    best_at = hn::IfThenElse(hn::RebindMask(di, better), index, best_at);
    index = hn::Add(index, hn::Set(di, static_cast<Index>(kStep)));
  }
  const T largest = hn::GetLane(hn::MaxOfLanes(d, best));
  if (!(largest > T(0))) return count;
  return FirstAt(best, largest, best_at);
}

template <typename T>
Extremes<T> Update(T* HWY_RESTRICT gradient, const T* HWY_RESTRICT row_i,
                   const T* HWY_RESTRICT row_j, T step, const T* HWY_RESTRICT may_rise,
                   const T* HWY_RESTRICT may_fall, std::size_t count) {
  constexpr Tag<T> d;
  constexpr IndexTag<T> di;
  using Index = hn::TFromD<IndexTag<T>>;
  constexpr std::size_t kStep = hn::MaxLanes(d);
  constexpr T kInfinity = std::numeric_limits<T>::infinity();
  const auto factor = hn::Set(d, step);
  auto smallest = hn::Set(d, kInfinity);
  auto largest = hn::Set(d, -kInfinity);
  auto smallest_at = hn::Zero(di);
  auto index = hn::Iota(di, 0);
  for (std::size_t k = 0; k < count; k += kStep) {
    const auto change = hn::Sub(hn::Load(d, row_i + k), hn::Load(d, row_j + k));
    const auto g = hn::MulAdd(factor, change, hn::Load(d, gradient + k));
    hn::Store(g, d, gradient + k);
    const auto rise = hn::Add(g, hn::Load(d, may_rise + k));
    smallest_at = hn::IfThenElse(hn::RebindMask(di, hn::Lt(rise, smallest)), index, smallest_at);
    smallest = hn::Min(smallest, rise);
    largest = hn::Max(largest, hn::Add(g, hn::Load(d, may_fall + k)));
    index = hn::Add(index, hn::Set(di, static_cast<Index>(kStep)));
  }
  const T least = hn::GetLane(hn::MinOfLanes(d, smallest));
  return {least, FirstAt(smallest, least, smallest_at), hn::GetLane(hn::MaxOfLanes(d, largest))};
}

SmoPasses<double> DoublePasses() {
  return {.choose_second = &ChooseSecond<double>, .update = &Update<double>};
}
SmoPasses<float> FloatPasses() {
  return {.choose_second = &ChooseSecond<float>, .update = &Update<float>};
}

}  // namespace dfr::kernel::internal::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dfr::kernel::internal {

HWY_EXPORT(DoublePasses);
HWY_EXPORT(FloatPasses);

template <>
SmoPasses<double> BestSmoPasses() {
  return HWY_DYNAMIC_DISPATCH(DoublePasses)();
}
template <>
SmoPasses<float> BestSmoPasses() {
  return HWY_DYNAMIC_DISPATCH(FloatPasses)();
}

}  // namespace dfr::kernel::internal
#endif  // HWY_ONCE
