#pragma once

namespace dfr::test {

/// Kills a writer at every `step`-th write to the disk, and expects at least `least` kills, none of
/// which loses an acknowledged episode.
void ExpectNoEpisodeLost(int step, int least);

}  // namespace dfr::test
