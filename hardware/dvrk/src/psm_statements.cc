#include "dfr/hardware/psm_statements.h"

namespace dfr::hardware {

void PsmStatements::Held(std::int64_t now_ns) noexcept {
  if (!held_last_) {
    awaits_ = true;
    held_ns_ = now_ns;
  }
  held_last_ = true;
}

bool PsmStatements::Take(int poses, int others, std::int64_t now_ns) noexcept {
  awaits_ = awaits_ && now_ns - held_ns_ <= kLongest;
  if (awaits_) {
    // Statements of poses were caused before the hold, because no set-point has been sent since.
    poses = 0;
    if (others > 0) {
      --others;
      awaits_ = false;
    }
  }
  const bool ours = others == 0 && poses <= (poses_ ? 1 : 0);
  if (poses > 0) poses_ = false;
  if (!ours) held_last_ = false;
  return ours;
}

}  // namespace dfr::hardware
