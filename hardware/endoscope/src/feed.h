#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <vector>

#include "dfr/hardware/endoscope.h"

namespace dfr::hardware::internal {

/// Passes pictures from a reading thread to a grabbing thread through three buffers. Each thread
/// owns one buffer and they exchange the third, so neither waits.
///
/// Put() and End() belong to the reading thread, Grab() to the grabbing thread.
class Feed {
 public:
  explicit Feed(const EndoscopeOptions& options);

  /// Puts a picture with three bytes per pixel (blue, green, red; or red, green, blue with `swap`)
  /// or one (grey). A picture not of the options' size becomes FrameStatus::kWrongSize.
  void Put(const std::uint8_t* data, int width, int height, std::size_t stride, int channels,
           bool swap, std::int64_t stamp_ns, std::int64_t arrival_ns);
  /// Puts a picture that cannot be decoded.
  void PutWrongEncoding(std::int64_t stamp_ns, std::int64_t arrival_ns);
  /// Reports that no more pictures will arrive.
  void End(FrameStatus why) noexcept;

  [[nodiscard]] FrameStatus Grab(std::int64_t steady_ns, std::int64_t wall_ns,
                                 Frame& frame) noexcept;
  [[nodiscard]] EndoscopeCounts counts() const noexcept;

 private:
  struct Slot {
    std::vector<std::uint8_t> pixels;
    FrameStatus status = FrameStatus::kNever;
    int width = 0;
    int height = 0;
    std::int64_t stamp_ns = 0;
    std::int64_t arrival_ns = 0;
    std::uint64_t sequence = 0;
  };
  void Hand(FrameStatus status, std::int64_t stamp_ns, std::int64_t arrival_ns);
  [[nodiscard]] FrameStatus Judge(const std::vector<std::uint8_t>& pixels);

  static constexpr unsigned kIndex = 3;
  static constexpr unsigned kFresh = 4;

  EndoscopeOptions options_;
  std::array<Slot, 3> slots_;
  std::atomic<unsigned> shared_{1};
  std::atomic<FrameStatus> end_{FrameStatus::kOk};
  std::atomic<std::uint64_t> received_{0};
  std::atomic<std::uint64_t> lost_{0};
  // Used only by the reading thread.
  unsigned back_ = 0;
  int repeats_ = 0;
  std::uint64_t last_hash_ = 0;
  std::int64_t last_stamp_ns_ = 0;
  // Used only by the grabbing thread.
  unsigned front_ = 2;
  std::uint64_t last_sequence_ = 0;
  std::atomic<std::uint64_t> missed_{0};
};

}  // namespace dfr::hardware::internal
