#pragma once

#include <cstddef>
#include <cstdint>

#include "dfr/dds/messages.h"

namespace dfr::test {

/// A picture of an endoscope, larger than a message of DDS: no two rows are equal.
inline dds::Image LargePicture() {
  dds::Image image;
  image.stamp = {3, 4};
  image.height = 480;
  image.width = 640;
  image.encoding = "bgr8";
  image.step = 1920;
  image.data.resize(std::size_t{480} * 1920);
  for (std::size_t i = 0; i < image.data.size(); ++i) {
    image.data[i] = static_cast<std::uint8_t>(i * 31 + i / 1920);
  }
  return image;
}

}  // namespace dfr::test
