#pragma once

#include <poll.h>

#include <utility>

namespace dfr::test {

/// Waits until `condition()` holds, checked a thousand times a second. The only limit is the test's
/// TIMEOUT: no machine is too slow.
template <typename Condition>
void Eventually(Condition&& condition) {
  while (!condition()) (void)::poll(nullptr, 0, 1);
}

}  // namespace dfr::test
