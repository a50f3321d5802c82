#pragma once

#include <poll.h>

#include <utility>

namespace dfr::test {

/// Waits until `condition()` holds, checked a thousand times a second. There is no limit except the
/// test's TIMEOUT, so that no machine is too slow.
template <typename Condition>
void Eventually(Condition&& condition) {
  while (!condition()) (void)::poll(nullptr, 0, 1);
}

}  // namespace dfr::test
