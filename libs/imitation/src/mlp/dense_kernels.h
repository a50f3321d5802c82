#pragma once

#include <cstddef>

namespace dfr::imitation::internal {

/// C = start + A B for A (m x k), B (k x n), C (m x n). Rows of B and C are contiguous. A can have
/// any strides: a transposed or constant A (both strides 0) costs nothing extra.
///
/// Each entry of C is summed over k in order, from the start value, for any m, n and position in C.
/// A row of a batch is bit-identical to the result of that row alone.
struct Product {
  int m = 0;
  int n = 0;
  int k = 0;
  const double* a = nullptr;
  std::ptrdiff_t a_row = 0;
  std::ptrdiff_t a_col = 0;
  const double* b = nullptr;
  std::ptrdiff_t b_row = 0;
  double* c = nullptr;
  std::ptrdiff_t c_row = 0;
  const double* bias = nullptr;  ///< n start values for every row of C; null: zero.
  bool accumulate = false;       ///< Start from the current entries of C, not from `bias`.
};

// The functions below use the widest instruction set of the machine and one thread. They never
// allocate.
void Multiply(const Product& product) noexcept;
/// values = tanh(values), within 4 units in the last place; NaN stays NaN.
void Tanh(double* values, std::size_t size) noexcept;
/// gradients *= 1 - tanh(a)^2, given activations = tanh(a).
void TimesTanhSlope(double* gradients, const double* activations, std::size_t size) noexcept;

}  // namespace dfr::imitation::internal
