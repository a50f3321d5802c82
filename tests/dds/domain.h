#pragma once

namespace dfr::test {

/// A DDS domain that no other test of this machine uses while this process lives, so that tests may
/// run at the same time. @throws std::runtime_error if all are taken.
int OwnDomain();

}  // namespace dfr::test
