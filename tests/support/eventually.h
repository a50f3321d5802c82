#pragma once

#include <poll.h>

#include <utility>

namespace dfr::test {

/// Waits until `condition()` holds, which is asked a thousand times a second. Has no limit of its
/// own: the test's TIMEOUT ends what never comes, so that no machine is too slow.
template <typename Condition>
void Eventually(Condition&& condition) {
  while (!condition()) (void)::poll(nullptr, 0, 1);
}

}  // namespace dfr::test
