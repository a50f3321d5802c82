#include "feed.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace dfr::hardware::internal {
namespace {

// Brightness is sampled at every 13th pixel.
constexpr std::size_t kBrightnessStep = 13;
// Samples with a lower green value are black. A picture with over 90 % black samples is dark.
constexpr std::uint8_t kBlack = 25;

std::uint64_t Hash(const std::vector<std::uint8_t>& pixels) noexcept {
  // FNV-1a over whole words, fast enough for any camera.
  std::uint64_t hash = 14695981039346656037ULL;
  std::size_t at = 0;
  for (; at + 8 <= pixels.size(); at += 8) {
    std::uint64_t word = 0;
    std::memcpy(&word, pixels.data() + at, 8);
    hash = (hash ^ word) * 1099511628211ULL;
  }
  for (; at < pixels.size(); ++at) hash = (hash ^ pixels[at]) * 1099511628211ULL;
  return hash;
}

bool Dark(const std::vector<std::uint8_t>& pixels) noexcept {
  std::size_t bright = 0;
  std::size_t all = 0;
  for (std::size_t at = 0; at + 3 <= pixels.size(); at += 3 * kBrightnessStep, ++all) {
    bright += pixels[at + 1] >= kBlack;  // green
  }
  return 10 * bright < all;
}

}  // namespace

Feed::Feed(const EndoscopeOptions& options) : options_(options) {
  options.Check();
  const std::size_t size =
      3 * static_cast<std::size_t>(options.width) * static_cast<std::size_t>(options.height);
  for (Slot& slot : slots_) slot.pixels.resize(size);
}

FrameStatus Feed::Judge(const std::vector<std::uint8_t>& pixels) {
  const std::uint64_t hash = Hash(pixels);
  repeats_ = hash == last_hash_ ? repeats_ + 1 : 1;
  last_hash_ = hash;
  if (Dark(pixels)) return FrameStatus::kDark;
  return repeats_ >= options_.max_repeats ? FrameStatus::kFrozen : FrameStatus::kOk;
}

void Feed::Hand(FrameStatus status, std::int64_t stamp_ns, std::int64_t arrival_ns) {
  Slot& slot = slots_[back_];
  slot.status = status;
  slot.stamp_ns = stamp_ns;
  slot.arrival_ns = arrival_ns;
  slot.sequence = received_.fetch_add(1, std::memory_order_relaxed) + 1;
  if (last_stamp_ns_ != 0 && stamp_ns != 0) {
    const double periods =
        1e-9 * static_cast<double>(stamp_ns - last_stamp_ns_) / options_.period_s;
    if (periods > 1.5 && periods < 1e9) {
      lost_.fetch_add(static_cast<std::uint64_t>(std::llround(periods)) - 1,
                      std::memory_order_relaxed);
    }
  }
  last_stamp_ns_ = stamp_ns;
  back_ = shared_.exchange(back_ | kFresh, std::memory_order_acq_rel) & kIndex;
}

void Feed::Put(const std::uint8_t* data, int width, int height, std::size_t stride, int channels,
               bool swap, std::int64_t stamp_ns, std::int64_t arrival_ns) {
  slots_[back_].width = width;
  slots_[back_].height = height;
  if (width != options_.width || height != options_.height) {
    Hand(FrameStatus::kWrongSize, stamp_ns, arrival_ns);
    return;
  }
  std::vector<std::uint8_t>& pixels = slots_[back_].pixels;
  const std::size_t row_size = 3 * static_cast<std::size_t>(width);
  for (int row = 0; row < height; ++row) {
    const std::uint8_t* from = data + static_cast<std::size_t>(row) * stride;
    std::uint8_t* to = pixels.data() + static_cast<std::size_t>(row) * row_size;
    if (channels == 1) {
      for (int col = 0; col < width; ++col, to += 3) std::fill_n(to, 3, from[col]);
    } else if (swap) {
      for (int col = 0; col < width; ++col, to += 3, from += 3) {
        to[0] = from[2];
        to[1] = from[1];
        to[2] = from[0];
      }
    } else {
      std::memcpy(to, from, row_size);
    }
  }
  Hand(Judge(pixels), stamp_ns, arrival_ns);
}

void Feed::PutWrongEncoding(std::int64_t stamp_ns, std::int64_t arrival_ns) {
  Hand(FrameStatus::kWrongEncoding, stamp_ns, arrival_ns);
}

void Feed::End(FrameStatus why) noexcept { end_.store(why, std::memory_order_release); }

FrameStatus Feed::Grab(std::int64_t steady_ns, std::int64_t wall_ns, Frame& frame) noexcept {
  const FrameStatus end = end_.load(std::memory_order_acquire);
  const bool fresh = (shared_.load(std::memory_order_relaxed) & kFresh) != 0;
  if (fresh) front_ = shared_.exchange(front_, std::memory_order_acq_rel) & kIndex;
  const Slot& slot = slots_[front_];
  frame.num_missed = fresh ? slot.sequence - last_sequence_ - 1 : 0;
  missed_.fetch_add(frame.num_missed, std::memory_order_relaxed);
  last_sequence_ = slot.sequence;
  if (slot.status == FrameStatus::kNever) return end == FrameStatus::kOk ? slot.status : end;

  frame.stamp_ns = slot.stamp_ns;
  frame.age_s = 1e-9 * static_cast<double>(wall_ns - slot.stamp_ns);
  frame.sequence = slot.sequence;
  frame.width = slot.width;
  frame.height = slot.height;
  const bool readable =
      slot.status != FrameStatus::kWrongSize && slot.status != FrameStatus::kWrongEncoding;
  frame.image = {};
  if (readable) {
    frame.image = {slot.pixels.data(), options_.width, options_.height,
                   3 * static_cast<std::size_t>(options_.width)};
  }
  // A picture that arrived before the end is still delivered.
  if (end != FrameStatus::kOk && !fresh) return end;
  if (!readable) return slot.status;
  if (slot.stamp_ns == 0) return FrameStatus::kInvalidStamp;
  const double silence_s = 1e-9 * static_cast<double>(steady_ns - slot.arrival_ns);
  if (silence_s > options_.max_age_s) return FrameStatus::kSilent;
  if (frame.age_s > options_.max_age_s) {
    // The picture was recent on arrival; only its successor is missing.
    return frame.age_s < 2.0 * silence_s ? FrameStatus::kSilent : FrameStatus::kOld;
  }
  if (-frame.age_s > options_.max_ahead_s) return FrameStatus::kAhead;
  return slot.status;
}

EndoscopeCounts Feed::counts() const noexcept {
  return {received_.load(std::memory_order_relaxed), missed_.load(std::memory_order_relaxed),
          lost_.load(std::memory_order_relaxed)};
}

}  // namespace dfr::hardware::internal
