#pragma once

namespace dfr::test {

/// Kills a writer at every `step`-th write to the disk, and expects that no acknowledged episode is
/// lost in at least `least` kills.
void ExpectNoEpisodeLost(int step, int least);

}  // namespace dfr::test
