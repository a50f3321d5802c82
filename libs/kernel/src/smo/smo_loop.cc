#include "smo/smo_loop.h"

#include <algorithm>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "smo/smo_loop.cc"
#include "hwy/foreach_target.h"  // recompiles this file for each instruction set
#include "hwy/highway.h"
#include "smo/smo_simd.h"
HWY_BEFORE_NAMESPACE();
namespace dfr::kernel::internal::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

template <typename T>
HWY_INLINE const T* Row(const RowTable<T>& rows, std::size_t i, std::size_t keep) {
  rows.used[i] = 1;
  const T* row = rows.known[i];
  return HWY_LIKELY(row != nullptr) ? row : rows.compute(rows.store, i, keep);
}

template <typename T>
struct Choice {
  std::size_t smallest_at;
  hn::Vec<Tag<T>> smallest;  // rounded; about kNever if there is none
  hn::Vec<Tag<T>> largest;
};

// Computes G += step (K_i - K_j). Returns min G over alpha < 1 and max G over alpha > 0.
template <typename T>
HWY_INLINE Choice<T> Update(const SmoProblem<T>& p, Numbered<T> numbered, const T* row_i,
                            const T* row_j, T step) {
  constexpr Tag<T> d;
  constexpr Bits<T> di;
  const auto factor = hn::Set(d, step);
  const auto one = hn::Set(di, 1);
  auto number = hn::Zero(di);
  auto smallest = numbered.Mark(hn::Set(d, SmoProblem<T>::kNever), number);
  auto largest = hn::Set(d, -SmoProblem<T>::kNever);
  HWY_UNROLL(4)
  for (std::size_t k = 0; k < p.count; k += hn::MaxLanes(d)) {
    const auto change = hn::Sub(hn::Load(d, row_i + k), hn::Load(d, row_j + k));
    const auto g = hn::MulAdd(factor, change, hn::Load(d, p.gradient + k));
    hn::Store(g, d, p.gradient + k);
    const auto rise = hn::Add(g, hn::Load(d, p.may_rise + k));
    smallest = hn::Min(smallest, numbered.Mark(rise, number));
    largest = hn::Max(largest, hn::Add(g, hn::Load(d, p.may_fall + k)));
    number = hn::Add(number, one);
  }
  const auto least = LeastOfLanes<T>(smallest);
  return {numbered.Index(smallest, least), least, hn::MaxOfLanes(d, largest)};
}

// Returns 1 / (1 - K), roughly. K rounds to 1 or above for nearly equal points. The lower bound of
// 1 - K prevents an infinite result, which a number in its low bits would make a NaN.
template <typename T>
HWY_INLINE hn::Vec<Tag<T>> InverseCurvature(hn::Vec<Tag<T>> row) {
  constexpr Tag<T> d;
  const auto curvature = hn::Sub(hn::Set(d, T(1)), row);
  return RoughReciprocal(d, hn::Max(curvature, hn::Set(d, kLeastCurvature<T>)));
}

// Returns the partner j of i that decreases the objective most (second order): the largest (G_j -
// G_i)^2 / (1 - K_ij) among alpha_j > 0. `row` holds K_ij or, if kInverse, InverseCurvature().
template <bool kInverse, typename T>
HWY_INLINE std::size_t ChooseSecond(const SmoProblem<T>& p, Numbered<T> numbered, const T* row,
                                    hn::Vec<Tag<T>> g_i) {
  constexpr Tag<T> d;
  constexpr Bits<T> di;
  const auto zero = hn::Zero(d);
  const auto one = hn::Set(di, 1);
  auto best = zero;
  auto number = hn::Zero(di);
  HWY_UNROLL(4)
  for (std::size_t k = 0; k < p.count; k += hn::MaxLanes(d)) {
    const auto fall = hn::Add(hn::Load(d, p.gradient + k), hn::Load(d, p.may_fall + k));
    const auto slope = hn::Max(hn::Sub(fall, g_i), zero);
    auto inverse = hn::Load(d, row + k);
    if constexpr (!kInverse) inverse = InverseCurvature<T>(inverse);
    const auto decrease = hn::Mul(hn::Mul(slope, slope), inverse);
    best = hn::Max(best, numbered.Mark(decrease, number));
    number = hn::Add(number, one);
  }
  return numbered.Index(best, MostOfPositiveLanes<T>(best));
}

// ChooseSecond() with the inverse curvatures of row i, which the first use computes.
template <typename T>
HWY_INLINE std::size_t ChoosePartner(const SmoProblem<T>& p, Numbered<T> numbered, std::size_t i,
                                     const T* row_i, hn::Vec<Tag<T>> g_i) {
  if (p.inverse == nullptr) return ChooseSecond<false>(p, numbered, row_i, g_i);
  constexpr Tag<T> d;
  T* HWY_RESTRICT inverse = p.inverse + i * p.count;
  if (HWY_UNLIKELY(p.inverse_known[i] == 0)) {
    HWY_UNROLL(4)
    for (std::size_t k = 0; k < p.count; k += hn::MaxLanes(d)) {
      hn::Store(InverseCurvature<T>(hn::Load(d, row_i + k)), d, inverse + k);
    }
    p.inverse_known[i] = 1;
  }
  return ChooseSecond<true>(p, numbered, inverse, g_i);
}

// Moves alpha from j to i and returns the amount, rounded to T for the update of G.
template <class Problem, typename T>
HWY_INLINE T Move(const Problem& p, std::size_t i, std::size_t j, T slope, T k_ij) {
  // For equal points, the step ends at a bound.
  const T curvature = T(2) * std::max(T(1) - k_ij, kLeastCurvature<T>);
  const double alpha_i = p.alpha[i];
  const double alpha_j = p.alpha[j];
  const double room = std::min(alpha_j, 1.0 - alpha_i);
  const T wanted = slope / curvature;
  const T step = std::min(wanted, static_cast<T>(room));
  // Sets alpha exactly to the reached bound, without rounding. Writes may_rise and
  // may_fall only on changes: reading a vector soon after a partial write is slow.
  const double taken = std::min(static_cast<double>(wanted), room);
  const bool fills = taken >= 1.0 - alpha_i;
  const bool empties = taken >= alpha_j;
  p.alpha[i] = fills ? 1.0 : alpha_i + taken;
  p.alpha[j] = empties ? 0.0 : alpha_j - taken;
  if (fills) p.may_rise[i] = Problem::kNever;
  if (empties) p.may_fall[j] = -Problem::kNever;
  if (alpha_i <= 0.0) p.may_fall[i] = T(0);
  if (alpha_j >= 1.0) p.may_rise[j] = T(0);
  return step;
}

template <typename T>
SmoSteps Loop(const SmoProblem<T>& problem, double target, std::int64_t most) {
  const SmoProblem<T> p = problem;
  const Numbered<T> numbered(p.count / hn::MaxLanes(Tag<T>()));
  constexpr T kNever = SmoProblem<T>::kNever;
  std::int64_t steps = 0;
  const T* row_i = p.gradient;  // any two equal rows leave G unchanged
  const T* row_j = p.gradient;
  T step = 0;
  while (true) {
    const Choice<T> choice = Update(p, numbered, row_i, row_j, step);
    const std::size_t i = choice.smallest_at;
    const T g_i = p.gradient[i] + p.may_rise[i];
    const T largest = hn::GetLane(choice.largest);
    if (g_i >= kNever || largest - g_i < static_cast<T>(target)) return {steps, false};
    if (steps == most) return {steps, true};
    row_i = Row(p.rows, i, i);
    const std::size_t j = ChoosePartner(p, numbered, i, row_i, choice.smallest);
    const T g_j = p.gradient[j] + p.may_fall[j];
    if (!(g_j > g_i)) return {steps, false};
    row_j = Row(p.rows, j, i);
    ++steps;
    step = Move(p, i, j, g_j - g_i, row_i[j]);
  }
}

template <typename T>
HWY_INLINE void FindExtremes(const SparseSmoProblem<T>& p, std::size_t group) {
  constexpr Tag<T> d;
  auto smallest = hn::Set(d, SparseSmoProblem<T>::kNever);
  auto largest = hn::Set(d, -SparseSmoProblem<T>::kNever);
  HWY_UNROLL(8)
  for (std::size_t k = 0; k < kSparseGroup; k += hn::MaxLanes(d)) {
    const std::size_t at = group * kSparseGroup + k;
    const auto g = hn::Load(d, p.gradient + at);
    smallest = hn::Min(smallest, hn::Add(g, hn::Load(d, p.may_rise + at)));
    largest = hn::Max(largest, hn::Add(g, hn::Load(d, p.may_fall + at)));
  }
  p.smallest[group] = hn::GetLane(hn::MinOfLanes(d, smallest));
  p.largest[group] = hn::GetLane(hn::MaxOfLanes(d, largest));
}

// G += step row.
template <typename T>
HWY_INLINE void AddStep(const SparseSmoProblem<T>& p, const SparseRow<T>& row, T step) {
  constexpr Tag<T> d;
  const auto factor = hn::Set(d, step);
  for (std::size_t q = 0; q < row.count; ++q) {
    T* HWY_RESTRICT gradient = p.gradient + row.groups[q] * kSparseGroup;
    const T* HWY_RESTRICT values = row.values + q * kSparseGroup;
    HWY_UNROLL(8)
    for (std::size_t k = 0; k < kSparseGroup; k += hn::MaxLanes(d)) {
      hn::Store(hn::MulAdd(factor, hn::Load(d, values + k), hn::Load(d, gradient + k)), d,
                gradient + k);
    }
  }
}

// Returns the index of the first entry of `values` that equals `value`. `values` must end with a
// whole vector.
template <typename T>
HWY_INLINE std::size_t FindValue(const T* values, T value) {
  constexpr Tag<T> d;
  const auto wanted = hn::Set(d, value);
  for (std::size_t k = 0;; k += hn::MaxLanes(d)) {
    const auto equal = hn::Eq(hn::Load(d, values + k), wanted);
    if (!hn::AllFalse(d, equal)) return k + static_cast<std::size_t>(hn::FindFirstTrue(d, equal));
  }
}

// Returns the first sample of `group` whose G + may equals `value`; there must be one.
template <typename T>
HWY_INLINE std::size_t FindSample(const SparseSmoProblem<T>& p, const T* may, std::size_t group,
                                  T value) {
  constexpr Tag<T> d;
  const auto wanted = hn::Set(d, value);
  for (std::size_t k = group * kSparseGroup;; k += hn::MaxLanes(d)) {
    const auto equal = hn::Eq(hn::Add(hn::Load(d, p.gradient + k), hn::Load(d, may + k)), wanted);
    if (!hn::AllFalse(d, equal)) return k + static_cast<std::size_t>(hn::FindFirstTrue(d, equal));
  }
}

template <typename T>
struct Partner {
  std::size_t sample;
  T k_ij;
};

// ChooseSecond() for sparse rows. Samples within reach of row i are compared one by one. All others
// have the same curvature: the best of these has the largest G over alpha > 0, and is in
// `far_group`.
template <typename T>
HWY_INLINE Partner<T> ChoosePartner(const SparseSmoProblem<T>& p, const SparseRow<T>& row_i, T g_i,
                                    std::size_t far_group) {
  constexpr Tag<T> d;
  constexpr Bits<T> di;
  using Int = hn::TFromD<Bits<T>>;
  const auto g = hn::Set(d, g_i);
  const auto unit = hn::Set(d, T(1));
  const auto least = hn::Set(d, kLeastCurvature<T>);
  auto best = hn::Zero(d);
  auto best_at = hn::Zero(di);
  for (std::size_t q = 0; q < row_i.count; ++q) {
    const std::size_t first = row_i.groups[q] * kSparseGroup;
    HWY_UNROLL(8)
    for (std::size_t k = 0; k < kSparseGroup; k += hn::MaxLanes(d)) {
      const auto fall =
          hn::Add(hn::Load(d, p.gradient + first + k), hn::Load(d, p.may_fall + first + k));
      const auto slope = hn::Max(hn::Sub(fall, g), hn::Zero(d));
      const auto curvature =
          hn::Max(hn::Sub(unit, hn::Load(d, row_i.values + q * kSparseGroup + k)), least);
      const auto decrease = hn::Mul(hn::Mul(slope, slope), RoughReciprocal(d, curvature));
      const auto better = hn::Gt(decrease, best);
      best = hn::IfThenElse(better, decrease, best);
      best_at = hn::IfThenElse(hn::RebindMask(di, better),
                               hn::Set(di, static_cast<Int>(q * kSparseGroup + k)), best_at);
    }
  }
  const auto most = hn::MaxOfLanes(d, best);
  const T far = p.largest[far_group];
  if (!((far - g_i) * (far - g_i) > hn::GetLane(most))) {
    const auto lane = static_cast<std::size_t>(hn::FindFirstTrue(d, hn::Eq(best, most)));
    alignas(64) Int places[64 / sizeof(T)];
    hn::Store(best_at, di, places);
    const std::size_t at = static_cast<std::size_t>(places[lane]) + lane;
    return {row_i.groups[at / kSparseGroup] * kSparseGroup + at % kSparseGroup, row_i.values[at]};
  }
  const std::size_t j = FindSample(p, p.may_fall, far_group, far);
  const std::uint32_t* end = row_i.groups + row_i.count;
  const std::uint32_t* at = std::lower_bound(row_i.groups, end, far_group);
  const bool reached = at != end && *at == far_group;
  const auto offset = static_cast<std::size_t>(at - row_i.groups) * kSparseGroup;
  return {j, reached ? row_i.values[offset + j % kSparseGroup] : T(0)};
}

template <typename T>
HWY_INLINE const SparseRow<T>& KnownRow(const SparseSmoProblem<T>& p, std::size_t i,
                                        std::size_t keep) {
  if (HWY_UNLIKELY(p.known[i].groups == nullptr)) p.compute(p.store, i, keep);
  return p.known[i];
}

template <typename T>
SmoSteps SparseLoop(const SparseSmoProblem<T>& problem, double target, std::int64_t most) {
  constexpr Tag<T> d;
  const SparseSmoProblem<T> p = problem;
  constexpr T kNever = SparseSmoProblem<T>::kNever;
  for (std::size_t group = 0; group < p.groups; ++group) FindExtremes(p, group);
  std::int64_t steps = 0;
  while (true) {
    auto smallest = hn::Set(d, kNever);
    auto largest = hn::Set(d, -kNever);
    for (std::size_t group = 0; group < p.groups; group += hn::MaxLanes(d)) {
      smallest = hn::Min(smallest, hn::Load(d, p.smallest + group));
      largest = hn::Max(largest, hn::Load(d, p.largest + group));
    }
    const T g_i = hn::GetLane(hn::MinOfLanes(d, smallest));
    const T g_far = hn::GetLane(hn::MaxOfLanes(d, largest));
    if (!(g_i < kNever) || !(g_far - g_i >= static_cast<T>(target))) return {steps, false};
    if (steps == most) return {steps, true};
    const std::size_t i = FindSample(p, p.may_rise, FindValue(p.smallest, g_i), g_i);
    const SparseRow<T> row_i = KnownRow(p, i, i);
    const Partner<T> j = ChoosePartner(p, row_i, g_i, FindValue(p.largest, g_far));
    const T g_j = p.gradient[j.sample] + p.may_fall[j.sample];
    if (!(g_j > g_i)) return {steps, false};
    const SparseRow<T> row_j = KnownRow(p, j.sample, i);
    ++steps;
    const T step = Move(p, i, j.sample, g_j - g_i, j.k_ij);
    AddStep(p, row_i, step);
    AddStep(p, row_j, -step);
    for (std::size_t q = 0; q < row_i.count; ++q) FindExtremes(p, row_i.groups[q]);
    for (std::size_t q = 0; q < row_j.count; ++q) FindExtremes(p, row_j.groups[q]);
  }
}

template <typename T>
void AddSparse(const SparseRow<T>& row, double weight, std::size_t first, std::size_t last,
               double* HWY_RESTRICT totals) {
  constexpr Tag<double> d;
  const hn::Rebind<T, Tag<double>> dt;
  const auto factor = hn::Set(d, weight);
  const std::uint32_t* end = row.groups + row.count;
  for (const std::uint32_t* group = std::lower_bound(row.groups, end, first);
       group != end && *group < last; ++group) {
    const T* HWY_RESTRICT values =
        row.values + static_cast<std::size_t>(group - row.groups) * kSparseGroup;
    double* HWY_RESTRICT total = totals + *group * kSparseGroup;
    HWY_UNROLL(8)
    for (std::size_t k = 0; k < kSparseGroup; k += hn::MaxLanes(d)) {
      auto value = hn::Zero(d);
      if constexpr (sizeof(T) == sizeof(double)) {
        value = hn::Load(dt, values + k);
      } else {
        value = hn::PromoteTo(d, hn::Load(dt, values + k));
      }
      hn::Store(hn::MulAdd(factor, value, hn::Load(d, total + k)), d, total + k);
    }
  }
}

// Computes kVectors vectors of totals in registers, starting at entry k.
template <std::size_t kVectors, typename T>
HWY_INLINE void CombineAt(const T* const* HWY_RESTRICT rows, const double* HWY_RESTRICT weights,
                          std::size_t rows_count, std::size_t k, double* HWY_RESTRICT totals) {
  constexpr Tag<double> d;
  const hn::Rebind<T, Tag<double>> dt;
  constexpr std::size_t kStep = hn::MaxLanes(d);
  hn::Vec<Tag<double>> sum[kVectors];
  HWY_UNROLL(8)
  for (std::size_t v = 0; v < kVectors; ++v) sum[v] = hn::Zero(d);
  for (std::size_t q = 0; q < rows_count; ++q) {
    const auto weight = hn::Set(d, weights[q]);
    HWY_UNROLL(8)
    for (std::size_t v = 0; v < kVectors; ++v) {
      const auto values = hn::Load(dt, rows[q] + k + v * kStep);
      if constexpr (sizeof(T) == sizeof(double)) {
        sum[v] = hn::MulAdd(weight, values, sum[v]);
      } else {
        sum[v] = hn::MulAdd(weight, hn::PromoteTo(d, values), sum[v]);
      }
    }
  }
  HWY_UNROLL(8)
  for (std::size_t v = 0; v < kVectors; ++v) hn::Store(sum[v], d, totals + k + v * kStep);
}

// Processes several cache lines of each row at a time, because rows are not in the nearest caches.
template <typename T>
void Combine(const T* const* HWY_RESTRICT rows, const double* HWY_RESTRICT weights,
             std::size_t rows_count, std::size_t size, double* HWY_RESTRICT totals) {
  constexpr std::size_t kLine = 64 / sizeof(T);
  constexpr std::size_t kLineVectors = kLine / hn::MaxLanes(Tag<double>());
  constexpr std::size_t kVectors = std::max<std::size_t>(8, kLineVectors);
  constexpr std::size_t kWhole = kVectors * hn::MaxLanes(Tag<double>());
  std::size_t k = 0;
  for (; k + kWhole <= size; k += kWhole) {
    CombineAt<kVectors>(rows, weights, rows_count, k, totals);
  }
  for (; k < size; k += kLine) CombineAt<kLineVectors>(rows, weights, rows_count, k, totals);
}

void FindExtremesOf(const double* HWY_RESTRICT alpha, const double* HWY_RESTRICT gradient,
                    std::size_t count, Extremes* HWY_RESTRICT extremes) {
  constexpr double kNone = std::numeric_limits<double>::infinity();
  // Visits the samples from `first` to `last`, in vectors with the tag `d`.
  const auto find = [&](auto d, std::size_t first, std::size_t last) HWY_ATTR {
    const auto zero = hn::Zero(d);
    const auto one = hn::Set(d, 1.0);
    const auto none = hn::Set(d, kNone);
    auto largest = hn::Neg(none);
    auto smallest = none;
    auto finite = zero;
    for (std::size_t i = first; i < last; i += hn::MaxLanes(d)) {
      const auto a = hn::LoadU(d, alpha + i);
      const auto g = hn::LoadU(d, gradient + i);
      const auto down = hn::IfThenElse(hn::Gt(a, zero), g, hn::Neg(none));
      const auto up = hn::IfThenElse(hn::Lt(a, one), g, none);
      largest = hn::IfThenElse(hn::Gt(down, largest), down, largest);
      smallest = hn::IfThenElse(hn::Lt(up, smallest), up, smallest);
      finite = hn::MulAdd(zero, g, finite);
    }
    extremes->largest = std::max(extremes->largest, hn::GetLane(hn::MaxOfLanes(d, largest)));
    extremes->smallest = std::min(extremes->smallest, hn::GetLane(hn::MinOfLanes(d, smallest)));
    extremes->finite += hn::GetLane(hn::SumOfLanes(d, finite));
  };
  *extremes = {-kNone, kNone, 0.0};
  const std::size_t whole = count / hn::MaxLanes(Tag<double>()) * hn::MaxLanes(Tag<double>());
  find(Tag<double>(), 0, whole);
  find(hn::CappedTag<double, 1>(), whole, count);
}

template <typename T>
SmoFunctions<T> Functions() {
  return {.loop = &Loop<T>,
          .combine = &Combine<T>,
          .sparse_loop = &SparseLoop<T>,
          .add_sparse = &AddSparse<T>};
}
SmoFunctions<double> DoubleSmo() { return Functions<double>(); }
SmoFunctions<float> FloatSmo() { return Functions<float>(); }

}  // namespace dfr::kernel::internal::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dfr::kernel::internal {

HWY_EXPORT(DoubleSmo);
HWY_EXPORT(FloatSmo);
HWY_EXPORT(FindExtremesOf);

Extremes FindExtremes(const double* alpha, const double* gradient, std::size_t count) noexcept {
  Extremes extremes;
  HWY_DYNAMIC_DISPATCH(FindExtremesOf)(alpha, gradient, count, &extremes);
  return extremes;
}

template <>
SmoFunctions<double> BestSmoFunctions() {
  return HWY_DYNAMIC_DISPATCH(DoubleSmo)();
}
template <>
SmoFunctions<float> BestSmoFunctions() {
  return HWY_DYNAMIC_DISPATCH(FloatSmo)();
}

}  // namespace dfr::kernel::internal
#endif  // HWY_ONCE
