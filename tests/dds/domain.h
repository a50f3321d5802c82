#pragma once

namespace dfr::test {

/// A DDS domain that no other test of this machine uses while this process lives: tests may run
/// concurrently. @throws std::runtime_error if all are taken.
int OwnDomain();

}  // namespace dfr::test
