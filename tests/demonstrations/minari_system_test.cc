#include <gtest/gtest.h>
#include <sys/resource.h>

#include "dfr/imitation/minari.h"
#include "tests/demonstrations/episodes.h"
#include "tests/imitation/temp_folder.h"

namespace dfr::imitation {
namespace {

// Both formats: reading or writing takes the memory of an episode, not of the file.
TEST(DemonstrationReaderTest, MemoryDoesNotGrowWithTheFile) {
  const test::TempFolder folder;
  core::Trajectory episode;
  episode.states = core::Matrix::Random(2001, 60);
  episode.controls = core::Matrix::Random(2000, 4);
  core::StateLayout layout;
  layout.Add("x", 60);
  constexpr int kEpisodes = 120;  // of 1 MB each
  const auto peak_mib = [] {
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    return usage.ru_maxrss / 1024;
  };
  const auto start = peak_mib();
  {
    MinariWriter minari(folder / "d", "dfr/test-v0", layout, 4, "long");
    RobomimicWriter robomimic(folder / "d.hdf5", layout, 4, "long");
    for (int i = 0; i < kEpisodes; ++i) {
      minari.Append(episode);
      robomimic.Append(episode);
    }
  }
  for (const char* path : {"d", "d.hdf5"}) {
    const auto reader = OpenDemonstrations(folder / path);
    ASSERT_EQ(reader->num_episodes(), kEpisodes);
    for (int i = 0; i < kEpisodes; ++i) EXPECT_EQ(reader->Read(i).controls, episode.controls);
  }
  // Includes the memory of libhdf5; the files have 120 and 240 MiB.
  EXPECT_LT(peak_mib() - start, 40);
}

}  // namespace
}  // namespace dfr::imitation
