#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace dfr::sim::internal {

/// Compresses BGR pictures, rows from the top without gaps. One object belongs to one thread.
class JpegEncoder {
 public:
  /// @param quality  in [1, 100].
  explicit JpegEncoder(int quality);
  ~JpegEncoder();
  JpegEncoder(const JpegEncoder&) = delete;
  JpegEncoder& operator=(const JpegEncoder&) = delete;

  /// Writes the file to `jpeg`, whose memory is used again.
  /// @throws std::runtime_error if libjpeg-turbo refuses.
  void Encode(std::span<const std::uint8_t> bgr, int width, int height,
              std::vector<std::uint8_t>& jpeg);

 private:
  void* handle_;
  int quality_;
};

}  // namespace dfr::sim::internal
