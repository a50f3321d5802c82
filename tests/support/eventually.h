#pragma once

#include <poll.h>

#include <utility>

namespace dfr::test {

/// Waits until `condition()` holds, checking a thousand times per second. The only limit is the
/// test's TIMEOUT, so any machine is fast enough.
template <typename Condition>
void Eventually(Condition&& condition) {
  while (!condition()) (void)::poll(nullptr, 0, 1);
}

}  // namespace dfr::test
