#pragma once

namespace dfr::test {

/// Returns a DDS domain reserved for this process until it ends: tests can run concurrently on one
/// machine. @throws std::runtime_error if all domains are taken.
int OwnDomain();

}  // namespace dfr::test
