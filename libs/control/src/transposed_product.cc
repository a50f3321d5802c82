#include "transposed_product.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "transposed_product.cc"
#include "hwy/foreach_target.h"  // recompiles this file for each instruction set
#include "hwy/highway.h"
HWY_BEFORE_NAMESPACE();
namespace dfr::control::internal::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

void Product(const double* left, std::size_t left_stride, std::size_t n_left, const float* right,
             std::size_t right_stride, std::size_t n_right, std::size_t rows, double* sums,
             std::size_t sums_stride) {
  const hn::CappedTag<double, kWidth> d;
  const hn::Rebind<float, decltype(d)> narrow;
  using V = hn::Vec<decltype(d)>;
  const std::size_t lanes = hn::Lanes(d);
  // kWidth rows of sums at a time keep their sums in registers, and the multipliers busy.
  for (std::size_t column = 0; column < n_right; column += lanes) {
    for (std::size_t first = 0; first < n_left; first += kWidth) {
      V s0 = hn::Zero(d);
      V s1 = s0;
      V s2 = s0;
      V s3 = s0;
      V s4 = s0;
      V s5 = s0;
      V s6 = s0;
      V s7 = s0;
      const double* a = left + first;
      const float* b = right + column;
      for (std::size_t i = 0; i < rows; ++i, a += left_stride, b += right_stride) {
        const V x = hn::PromoteTo(d, hn::LoadU(narrow, b));
        s0 = hn::MulAdd(hn::Set(d, a[0]), x, s0);
        s1 = hn::MulAdd(hn::Set(d, a[1]), x, s1);
        s2 = hn::MulAdd(hn::Set(d, a[2]), x, s2);
        s3 = hn::MulAdd(hn::Set(d, a[3]), x, s3);
        s4 = hn::MulAdd(hn::Set(d, a[4]), x, s4);
        s5 = hn::MulAdd(hn::Set(d, a[5]), x, s5);
        s6 = hn::MulAdd(hn::Set(d, a[6]), x, s6);
        s7 = hn::MulAdd(hn::Set(d, a[7]), x, s7);
      }
      double* out = sums + first * sums_stride + column;
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
}

}  // namespace dfr::control::internal::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dfr::control::internal {

HWY_EXPORT(Product);

void TransposedProduct(const double* left, std::size_t left_stride, std::size_t n_left,
                       const float* right, std::size_t right_stride, std::size_t n_right,
                       std::size_t rows, double* sums, std::size_t sums_stride) noexcept {
  HWY_DYNAMIC_DISPATCH(Product)
  (left, left_stride, n_left, right, right_stride, n_right, rows, sums, sums_stride);
}

}  // namespace dfr::control::internal
#endif  // HWY_ONCE
