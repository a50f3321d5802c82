#pragma once

namespace dfr::test {

/// Sends a picture repeatedly until it arrives. Parts of it that are lost are sent again, unless
/// the next picture replaces them: `heard` waits so many seconds for it, each time twice as many,
/// so that no machine is too slow.
template <typename Say, typename Heard>
void RepeatUntilHeard(Say&& say, Heard&& heard) {
  for (double wait_s = 0.1;; wait_s *= 2.0) {
    say();
    if (heard(wait_s)) return;
  }
}

}  // namespace dfr::test
