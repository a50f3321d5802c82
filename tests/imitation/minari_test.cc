#include "dfr/imitation/minari.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <cstdlib>
#include <filesystem>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>

#include "hdf5_file.h"
#include "tests/imitation/temp_folder.h"

namespace dfr::imitation {
namespace {

using core::Outcome;
using internal::Hdf5File;
using testing::AllOf;
using testing::HasSubstr;

constexpr char kId[] = "dfr/test-v0";

// The same numbers as in minari_peer.py, all exact in binary but the thirds, which both sides
// compute alike.
core::Trajectory Episode(int index) {
  static constexpr int kLengths[] = {3, 1, 12};
  const int n = kLengths[index];
  core::Trajectory trajectory;
  trajectory.states.resize(n + 1, 6);
  trajectory.controls.resize(n, 2);
  for (int t = 0; t <= n; ++t) {
    for (int k = 0; k < 6; ++k) trajectory.states(t, k) = index + 0.25 * t + k / 3.0;
    for (int k = 0; k < 2 && t < n; ++k) trajectory.controls(t, k) = (index - t) / 16.0 + k / 2.0;
  }
  trajectory.outcome = index == 1 ? Outcome::kHalted : Outcome::kCompleted;
  trajectory.seed = 0xfedcba9876543210u + static_cast<std::uint64_t>(index);
  return trajectory;
}

DemonstrationSet Episodes(bool plain) {
  DemonstrationSet set;
  if (plain) {
    set.layout.Add("observations", 6);
  } else {
    set.layout.Add("tip", 3);
    set.layout.Add("object", 2);
    set.layout.Add("angle", 1);
  }
  set.control_dim = 2;
  set.environment = "pusher \"P\"";
  set.trajectories = {Episode(0), Episode(1), Episode(2)};
  return set;
}

void RunPeer(const std::string& mode, const std::filesystem::path& folder) {
  const std::string command =
      DFR_PYTHON " " DFR_MINARI_PEER " " + mode + " '" + folder.string() + "'";
  ASSERT_EQ(std::system(command.c_str()), 0) << command << "\n(needs Debian's python3-h5py)";
}

std::string MessageOf(const std::function<void()>& call) {
  try {
    call();
  } catch (const std::exception& e) {
    return e.what();
  }
  return "nothing thrown";
}

class MinariTest : public testing::TestWithParam<bool> {};

TEST_P(MinariTest, ADatasetRestoresEverything) {
  const test::TempFolder folder;
  const DemonstrationSet set = Episodes(GetParam());
  SaveMinari(set, folder / "test-v0", kId);
  for (const char* path : {"test-v0", "test-v0/data", "test-v0/data/main_data.hdf5"}) {
    const DemonstrationSet loaded = LoadDemonstrations(folder / path);
    EXPECT_EQ(loaded.layout, set.layout);
    EXPECT_EQ(loaded.control_dim, 2);
    EXPECT_EQ(loaded.environment, set.environment);
    ASSERT_EQ(loaded.trajectories.size(), 3u);
    for (std::size_t i = 0; i < 3; ++i) {
      EXPECT_EQ(loaded.trajectories[i].states, set.trajectories[i].states);
      EXPECT_EQ(loaded.trajectories[i].controls, set.trajectories[i].controls);
      EXPECT_EQ(loaded.trajectories[i].outcome, set.trajectories[i].outcome);
      EXPECT_EQ(loaded.trajectories[i].seed, set.trajectories[i].seed);
    }
  }
}

TEST_P(MinariTest, AnIndependentReaderFindsEveryValue) {
  const test::TempFolder folder;
  SaveMinari(Episodes(GetParam()), folder / "test-v0", kId);
  RunPeer(GetParam() ? "check-plain" : "check", folder / "test-v0");
}

TEST_P(MinariTest, ADatasetOfAnIndependentWriterIsRead) {
  const test::TempFolder folder;
  RunPeer(GetParam() ? "write-plain" : "write", folder / "lift-v0");
  const auto reader = OpenDemonstrations(folder / "lift-v0");
  EXPECT_EQ(reader->environment(), "Lift-v1");
  EXPECT_EQ(reader->control_dim(), 2);
  ASSERT_EQ(reader->num_episodes(), 3);
  EXPECT_EQ(reader->name(2), "episode_10");
  core::StateLayout by_name;
  if (GetParam()) {
    by_name.Add("observations", 6);
  } else {
    by_name.Add("angle", 1);
    by_name.Add("goal/object", 2);
    by_name.Add("tip", 3);
  }
  EXPECT_EQ(reader->layout(), by_name);
  for (int i = 0; i < 3; ++i) {
    const core::Trajectory actual = reader->Read(i);
    const core::Trajectory expected = Episode(i);
    if (GetParam()) {
      EXPECT_EQ(actual.states, expected.states);
    } else {
      EXPECT_EQ(actual.states.col(0), expected.states.col(5));
      EXPECT_EQ(actual.states.middleCols(1, 2), expected.states.middleCols(3, 2));
      EXPECT_EQ(actual.states.rightCols(3), expected.states.leftCols(3));
    }
    EXPECT_EQ(actual.controls, expected.controls);  // sixteenths are exact in float32
    EXPECT_EQ(actual.outcome, i == 2 ? Outcome::kCompleted : Outcome::kHalted);
    EXPECT_EQ(actual.seed, 70u + static_cast<unsigned>(i));
  }
}

INSTANTIATE_TEST_SUITE_P(Observations, MinariTest, testing::Bool(),
                         [](const auto& instance) { return instance.param ? "Plain" : "Named"; });

TEST(MinariErrorsTest, NameTheDatasetAndTheReason) {
  const test::TempFolder folder;
  SaveMinari(Episodes(false), folder / "d", kId);
  const std::filesystem::path file = folder / "d/data/main_data.hdf5";
  const auto broken = [&](const std::function<void(Hdf5File&)>& build) {
    {
      Hdf5File f = Hdf5File::Create(folder / "broken.hdf5");
      f.CreateGroup("episode_0");
      build(f);
    }
    return MessageOf([&] { (void)OpenMinari(folder / "broken.hdf5")->Read(0); });
  };
  const core::Matrix four = core::Matrix::Ones(4, 2);
  const core::Matrix three = core::Matrix::Ones(3, 2);
  EXPECT_THAT(broken([](auto&) {}),
              AllOf(HasSubstr("broken.hdf5"), HasSubstr("episode_0/observations: does not exist")));
  EXPECT_THAT(broken([&](auto& f) { f.Write("episode_0/observations", four); }),
              HasSubstr("episode_0/actions: does not exist"));
  EXPECT_THAT(broken([&](auto& f) {
                f.Write("episode_0/observations", three);
                f.Write("episode_0/actions", three);
              }),
              HasSubstr("observations: has 3 rows; that of actions plus one is 4"));
  EXPECT_THAT(broken([&](auto& f) {
                f.Write("episode_0/observations", four);
                f.Write("episode_0/actions", three);
                f.SetAttribute("episode_0", "total_steps", 7);
              }),
              HasSubstr("episode_0: total_steps is 7, but there are 3 actions"));
  EXPECT_THAT(broken([&](auto& f) {
                core::Matrix bad = four;
                bad(2, 1) = std::numeric_limits<double>::quiet_NaN();
                f.Write("episode_0/observations", bad);
                f.Write("episode_0/actions", three);
              }),
              HasSubstr("episode_0/observations: row 2, column 1 is nan"));
  std::filesystem::create_directories(folder / "empty");
  EXPECT_THAT(MessageOf([&] { (void)OpenDemonstrations(folder / "empty"); }),
              HasSubstr("has no data/main_data.hdf5"));
  EXPECT_THAT(MessageOf([&] { (void)OpenDemonstrations(folder / "absent"); }),
              HasSubstr("no such file"));

  DemonstrationSet beyond = Episodes(false);
  beyond.trajectories[2].controls(7, 1) = 1.5;
  EXPECT_THAT(MessageOf([&] { SaveMinari(beyond, folder / "d", kId); }),
              HasSubstr("demonstration 2, step 7: control 1 is 1.5"));
  EXPECT_EQ(OpenMinari(file)->num_episodes(), 3);  // what was there is untouched
}

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
    MinariWriter minari(folder / "d", kId, layout, 4, "long");
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
  // libhdf5 keeps some of its own; the files are of 120 and 240 MiB.
  EXPECT_LT(peak_mib() - start, 40);
}

}  // namespace
}  // namespace dfr::imitation
