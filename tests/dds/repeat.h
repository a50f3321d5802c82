#pragma once

namespace dfr::test {

/// Sends a picture repeatedly until it arrives. DDS resends lost parts unless the next picture
/// replaces them. `heard(wait_s)` waits up to `wait_s` seconds. Each repetition doubles this time:
/// no machine is too slow.
template <typename Say, typename Heard>
void RepeatUntilHeard(Say&& say, Heard&& heard) {
  for (double wait_s = 0.1;; wait_s *= 2.0) {
    say();
    if (heard(wait_s)) return;
  }
}

}  // namespace dfr::test
