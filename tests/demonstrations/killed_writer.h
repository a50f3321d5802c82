#pragma once

namespace dfr::test {

/// A writer that is killed at every `step`-th write to the disk, or never, keeps every appended
/// episode. Expects at least `least` kills.
void ExpectNoEpisodeLost(int step, int least);

}  // namespace dfr::test
