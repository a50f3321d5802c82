#pragma once

#include <string_view>

#include "dfr/recording/recorder.h"

namespace dfr::recording {

/// Encodes pictures as JPEG. One object belongs to one thread.
class JpegEncoder {
 public:
  /// @param quality  in [1, 100].
  /// @throws std::runtime_error if memory runs out.
  explicit JpegEncoder(int quality);
  ~JpegEncoder();
  JpegEncoder(const JpegEncoder&) = delete;
  JpegEncoder& operator=(const JpegEncoder&) = delete;

  /// Returns the JPEG data, valid until the next call; empty if encoding fails. JPEG pictures are
  /// returned unchanged.
  [[nodiscard]] std::string_view Encode(const PictureView& picture);

 private:
  int quality_;
  void* compressor_;
  unsigned char* bytes_ = nullptr;
  unsigned long capacity_ = 0;  // NOLINT(google-runtime-int): the library's type
};

}  // namespace dfr::recording
