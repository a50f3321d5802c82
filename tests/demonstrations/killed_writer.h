#pragma once

namespace dfr::test {

/// A writer that is killed at every `step`-th of its writes to the disk, or not at all, leaves
/// every episode that it had appended. Expects at least `least` kills.
void ExpectNoEpisodeLost(int step, int least);

}  // namespace dfr::test
