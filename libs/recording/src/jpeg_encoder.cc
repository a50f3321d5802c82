#include "dfr/recording/jpeg_encoder.h"

#include <turbojpeg.h>

#include <stdexcept>

namespace dfr::recording {

JpegEncoder::JpegEncoder(int quality) : quality_(quality), compressor_(tjInitCompress()) {
  if (compressor_ == nullptr) throw std::runtime_error("libjpeg-turbo cannot start");
}

JpegEncoder::~JpegEncoder() {
  tjFree(bytes_);
  tjDestroy(compressor_);
}

std::string_view JpegEncoder::Encode(const PictureView& picture) {
  if (picture.format == PictureFormat::kJpeg) {
    return {reinterpret_cast<const char*>(picture.data.data()), picture.data.size()};
  }
  const bool gray = picture.format == PictureFormat::kMono8;
  const int pixels = gray                                     ? TJPF_GRAY
                     : picture.format == PictureFormat::kRgb8 ? TJPF_RGB
                                                              : TJPF_BGR;
  unsigned long size = capacity_;  // NOLINT(google-runtime-int): the library's type
  if (tjCompress2(compressor_, picture.data.data(), picture.width, picture.step, picture.height,
                  pixels, &bytes_, &size, gray ? TJSAMP_GRAY : TJSAMP_420, quality_, 0) != 0) {
    return {};
  }
  if (size > capacity_) capacity_ = size;
  return {reinterpret_cast<const char*>(bytes_), size};
}

}  // namespace dfr::recording
