#include "dfr/hardware/word_limit.h"

#include <utility>

namespace dfr::hardware {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;

}  // namespace

bool WordLimit::Passes(std::int64_t steady_ns) noexcept {
  if (!any_ || steady_ns - since_ns_ >= kSecond) {
    any_ = true;
    shown_ = 0;
    since_ns_ = steady_ns;
  }
  if (shown_ < per_second_) {
    ++shown_;
    return true;
  }
  if (left_out_++ == 0) told_ns_ = steady_ns;
  return false;
}

std::uint64_t WordLimit::TakeLeftOut(std::int64_t steady_ns) noexcept {
  if (left_out_ == 0 || steady_ns - told_ns_ < kSecond) return 0;
  told_ns_ = steady_ns;
  return std::exchange(left_out_, 0);
}

}  // namespace dfr::hardware
