#pragma once

#include <cstddef>
#include <cstdint>

namespace dfr::vision {

/// A colour image of 8 bits a channel, blue, green, red interleaved, rows from the top. Borrowed.
struct ImageView {
  const std::uint8_t* data = nullptr;
  int width = 0;
  int height = 0;
  std::size_t stride = 0;  ///< Bytes from one row to the next, >= 3 width.
};

}  // namespace dfr::vision
