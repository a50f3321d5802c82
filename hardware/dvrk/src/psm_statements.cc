#include "dfr/hardware/psm_statements.h"

#include <algorithm>
#include <functional>

namespace dfr::hardware {

// Forgets the oldest round if there are too many; its answers then end in hold.
PsmStatements::Round& PsmStatements::Begin(std::int64_t now_ns) noexcept {
  if (size_ == rounds_.size()) Drop(0);
  rounds_[size_] = {.since_ns = now_ns};
  return rounds_[size_++];
}

PsmStatements::Round& PsmStatements::Last(std::int64_t now_ns) noexcept {
  return size_ == 0 ? Begin(now_ns) : rounds_[size_ - 1];
}

void PsmStatements::Drop(std::size_t index) noexcept {
  std::copy(rounds_.begin() + static_cast<std::ptrdiff_t>(index) + 1,
            rounds_.begin() + static_cast<std::ptrdiff_t>(size_),
            rounds_.begin() + static_cast<std::ptrdiff_t>(index));
  --size_;
}

void PsmStatements::Forget(std::int64_t now_ns) noexcept {
  for (std::size_t i = 0; i < size_;) {
    Round& round = rounds_[i];
    const bool last = i + 1 == size_;
    if (now_ns - round.since_ns > kLongest) {
      round.others = 0;
      // The set-points of the last round go on, and may change the control at any time.
      round.poses = round.poses && last;
    }
    if (!last && round.others == 0 && !round.poses) {
      Drop(i);
    } else {
      ++i;
    }
  }
}

void PsmStatements::Held(std::int64_t now_ns) noexcept {
  if (!held_last_) Begin(now_ns).others = 1;
  held_last_ = true;
}

void PsmStatements::Requested(std::int64_t now_ns) noexcept {
  Begin(now_ns).others = 1;
  held_last_ = false;
}

void PsmStatements::Armed(std::int64_t now_ns) noexcept { Last(now_ns).poses = true; }

// Before the first set-point of the arm, one of the jaw brings joint space.
void PsmStatements::JawMoved(std::int64_t now_ns) noexcept {
  Round& round = Last(now_ns);
  if (!round.poses) return;
  ++round.others;
  round.since_ns = now_ns;
}

bool PsmStatements::Take(int poses, int others, std::int64_t now_ns) noexcept {
  Forget(now_ns);
  bool ours = true;
  for (; others > 0; --others) {
    const auto end = rounds_.begin() + static_cast<std::ptrdiff_t>(size_);
    const auto round =
        std::find_if(rounds_.begin(), end, [](const Round& each) { return each.others > 0; });
    if (round == end) {
      ours = held_last_ = false;
    } else {
      --round->others;
    }
  }
  for (; poses > 0; --poses) {
    const auto end = rounds_.begin() + static_cast<std::ptrdiff_t>(size_);
    const auto round = std::find_if(rounds_.begin(), end, std::mem_fn(&Round::poses));
    if (round == end) {
      ours = held_last_ = false;
      continue;
    }
    round->poses = false;
    for (auto earlier = rounds_.begin(); earlier <= round; ++earlier) earlier->others = 0;
  }
  return ours;
}

}  // namespace dfr::hardware
