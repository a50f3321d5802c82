#include "jpeg.h"

#include <turbojpeg.h>

#include <stdexcept>
#include <string>

namespace dfr::sim::internal {

JpegEncoder::JpegEncoder(int quality) : handle_(tjInitCompress()), quality_(quality) {
  if (handle_ == nullptr) throw std::runtime_error("libjpeg-turbo: cannot start");
}

JpegEncoder::~JpegEncoder() { tjDestroy(handle_); }

void JpegEncoder::Encode(std::span<const std::uint8_t> bgr, int width, int height,
                         std::vector<std::uint8_t>& jpeg) {
  jpeg.resize(tjBufSize(width, height, TJSAMP_420));
  unsigned char* out = jpeg.data();
  unsigned long size = jpeg.size();
  if (tjCompress2(handle_, bgr.data(), width, 3 * width, height, TJPF_BGR, &out, &size, TJSAMP_420,
                  quality_, TJFLAG_NOREALLOC) != 0) {
    throw std::runtime_error(std::string("libjpeg-turbo: ") + tjGetErrorStr2(handle_));
  }
  jpeg.resize(size);
}

}  // namespace dfr::sim::internal
