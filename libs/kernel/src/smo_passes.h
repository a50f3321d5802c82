#pragma once

#include <cstddef>

namespace dfr::kernel::internal {

/// What a pass over the gradient finds.
template <typename T>
struct Extremes {
  T smallest;  ///< min of G over alpha < 1, +infinity if there is none.
  std::size_t smallest_at;
  T largest;  ///< max of G over alpha > 0, -infinity if there is none.
};

/// The two loops of SMO over all samples. Arrays are aligned to 64 bytes and padded to whole cache
/// lines: `may_fall` is 0 where alpha > 0, else -infinity; `may_rise` is 0 where alpha < 1, else
/// +infinity; both exclude the padding. `count` includes it.
template <typename T>
struct SmoPasses {
  /// The j that, paired with i, decreases the objective most (second order): the largest
  /// (G_j - g_i)^2 / max(2 - 2 K_ij, tiny) among G_j > g_i with alpha_j > 0. `count` if none.
  std::size_t (*choose_second)(const T* row_i, const T* gradient, const T* may_fall, T g_i,
                               std::size_t count) = nullptr;
  /// G += step (K_i - K_j), and the extremes of the result.
  Extremes<T> (*update)(T* gradient, const T* row_i, const T* row_j, T step, const T* may_rise,
                        const T* may_fall, std::size_t count) = nullptr;
};

/// For the widest instruction set of this machine, or the one that ForceTarget() chose.
template <typename T>
[[nodiscard]] SmoPasses<T> BestSmoPasses();

}  // namespace dfr::kernel::internal
