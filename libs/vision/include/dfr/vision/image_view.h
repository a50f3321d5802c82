#pragma once

#include <cstddef>
#include <cstdint>

namespace dfr::vision {

/// 8-bit colour image with interleaved blue, green and red channels, rows from the top. Borrowed.
struct ImageView {
  const std::uint8_t* data = nullptr;
  int width = 0;
  int height = 0;
  std::size_t stride = 0;  ///< Bytes from one row to the next, >= 3 width.
};

}  // namespace dfr::vision
