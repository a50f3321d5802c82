#include "dfr/imitation/demonstrations.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <limits>
#include <stdexcept>

#include "hdf5/hdf5_file.h"
#include "tests/demonstrations/episodes.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::imitation {
namespace {

using core::Outcome;
using internal::Hdf5File;
using test::Episode;
using test::Episodes;
using testing::AllOf;
using testing::HasSubstr;

TEST(DemonstrationsTest, AFileRestoresEverything) {
  const test::TempFolder folder;
  DemonstrationSet set = Episodes();
  set.layout.blocks[1].name = "goal/object";
  set.provenance = {core::Origin::kReal, "PSM1", "A7", "left eye", "2026-11-23"};
  SaveRobomimic(set, folder / "demos.hdf5", "<mujoco/>");
  const DemonstrationSet loaded = LoadRobomimic(folder / "demos.hdf5");
  test::ExpectSame(loaded, set);
  EXPECT_EQ(loaded.discarded, 2);
  EXPECT_EQ(loaded.provenance, set.provenance);
}

TEST(DemonstrationsTest, AnIndependentReaderFindsEveryValue) {
  const test::TempFolder folder;
  SaveRobomimic(Episodes(), folder / "demos.hdf5", "<mujoco/>");
  test::RunPeer("robomimic_peer.py", "check", folder / "demos.hdf5");
}

TEST(DemonstrationsTest, AFileOfAnIndependentWriterIsRead) {
  const test::TempFolder folder;
  test::RunPeer("robomimic_peer.py", "write", folder / "peer.hdf5");
  const DemonstrationSet loaded = LoadRobomimic(folder / "peer.hdf5");
  EXPECT_EQ(loaded.environment, "Lift");
  EXPECT_EQ(loaded.control_dim, 2);
  core::StateLayout by_name;
  by_name.Add("angle", 1);
  by_name.Add("object", 2);
  by_name.Add("tip", 3);
  EXPECT_EQ(loaded.layout, by_name);
  ASSERT_EQ(loaded.trajectories.size(), 3u);
  for (int i = 0; i < 3; ++i) {
    const core::Trajectory& actual = loaded.trajectories[static_cast<std::size_t>(i)];
    const core::Trajectory expected = Episode(i);
    test::ExpectStatesByName(actual.states, expected.states);
    EXPECT_EQ(actual.controls, expected.controls);  // sixteenths are exact in float32
    EXPECT_EQ(actual.outcome, Outcome::kCompleted);
  }
}

TEST(DemonstrationsTest, WithoutNextObsTheLastControlIsLeftOut) {
  const test::TempFolder folder;
  {
    Hdf5File file = Hdf5File::Create(folder / "demos.hdf5");
    for (const char* group : {"data", "data/demo_0", "data/demo_0/obs"}) file.CreateGroup(group);
    const core::Trajectory episode = Episode(0);
    file.Write("data/demo_0/obs/tip", core::Matrix(episode.states.topRows(3)));
    file.Write("data/demo_0/actions", episode.controls);
    file.SetAttribute("data/demo_0", "num_samples", 3);
  }
  const DemonstrationSet loaded = LoadRobomimic(folder / "demos.hdf5");
  EXPECT_EQ(loaded.trajectories[0].num_steps(), 2);
  EXPECT_EQ(loaded.trajectories[0].states, Episode(0).states.topRows(3));
  EXPECT_EQ(loaded.trajectories[0].outcome, Outcome::kHalted);
}

TEST(DemonstrationsTest, MismatchedShapesAreRefusedBeforeWriting) {
  const test::TempFolder folder;
  const auto message = [&](auto change) {
    DemonstrationSet set = Episodes();
    change(set);
    return test::MessageOf<std::invalid_argument>(
        [&] { SaveRobomimic(set, folder / "demos.hdf5"); });
  };
  EXPECT_THAT(message([](auto& set) { set.trajectories[2].controls(7, 1) = 1.5; }),
              HasSubstr("demonstration 2, step 7: control 1 is 1.5"));
  EXPECT_THAT(message([](auto& set) {
                set.trajectories[1].states(1, 5) = std::numeric_limits<double>::quiet_NaN();
              }),
              HasSubstr("demonstration 1, step 1: state entry 5 is nan"));
  EXPECT_THAT(message([](auto& set) { set.trajectories[0].states.conservativeResize(3, 6); }),
              HasSubstr("demonstration 0 has states of 3 x 6"));
  EXPECT_THAT(message([](auto& set) { set.trajectories[0].controls.resize(0, 2); }),
              HasSubstr("demonstration 0 has no control"));
  for (const char* name : {"", "/a", "a/", "a//b", "a/./b", "tip/a", "tip"}) {
    EXPECT_THAT(message([&](auto& set) { set.layout.blocks[1].name = name; }),
                HasSubstr("'" + std::string(name) + "'"));
  }
  EXPECT_FALSE(std::filesystem::exists(folder / "demos.hdf5"));
}

// Damages a valid file in several ways, one after the other, by plain HDF5 calls.
TEST(DemonstrationsTest, ErrorsNameFileEpisodeAndDataset) {
  const test::TempFolder folder;
  const std::filesystem::path path = folder / "demos.hdf5";
  const auto message = [&](auto damage) {
    {
      Hdf5File file = Hdf5File::Create(path);
      for (const char* group : {"data", "data/demo_0", "data/demo_0/obs", "data/demo_0/next_obs"}) {
        file.CreateGroup(group);
      }
      file.SetAttribute("data/demo_0", "num_samples", 3);
      const core::Matrix tip = core::Matrix::Zero(3, 2);
      file.Write("data/demo_0/obs/tip", tip);
      file.Write("data/demo_0/next_obs/tip", tip);
      damage(file);
    }
    return test::MessageOf<std::runtime_error>([&] { (void)LoadRobomimic(path); });
  };
  const auto rows = [](Eigen::Index count) { return core::Matrix::Zero(count, 2).eval(); };
  const auto with = [&](Eigen::Index count, double last) {
    core::Matrix u = rows(count);
    u(2, 1) = last;
    return [u](Hdf5File& f) { f.Write("data/demo_0/actions", u); };
  };
  // Writes valid actions, and a second episode with only `part` of its observations.
  const auto second = [&](Hdf5File& f, const std::string& part) {
    f.Write("data/demo_0/actions", rows(3));
    f.CreateGroup("data/demo_1");
    f.CreateGroup("data/demo_1/obs");
    f.Write("data/demo_1/obs/" + part, rows(3));
  };

  EXPECT_THAT(message([](Hdf5File&) {}),
              AllOf(HasSubstr(path.string()), HasSubstr("data/demo_0/actions: does not exist")));
  EXPECT_THAT(message(with(4, 0.0)),
              HasSubstr("data/demo_0/actions: has 4 rows; num_samples is 3"));
  EXPECT_THAT(message(with(3, std::numeric_limits<double>::infinity())),
              HasSubstr("data/demo_0/actions: row 2, column 1 is inf"));
  EXPECT_THAT(message(with(3, -1e300)),
              HasSubstr("data/demo_0/actions: row 2, column 1 is 1e+300 in magnitude, where "
                        "3.40282e+38 is the limit"));
  EXPECT_THAT(message([&](Hdf5File& f) {
                f.Write("data/demo_0/actions", rows(3));
                f.Write("data/demo_0/obs/object", rows(3));
              }),
              HasSubstr("data/demo_0/next_obs/object: does not exist"));
  EXPECT_THAT(message([&](Hdf5File& f) {
                second(f, "tip");
                f.Write("data/demo_1/actions", rows(3));
                f.CreateGroup("data/demo_2");
                f.SetAttribute("data/demo_2", "num_samples", 3);
              }),
              HasSubstr("data/demo_1: has no attribute num_samples"));
  EXPECT_THAT(message([&](Hdf5File& f) {
                second(f, "object");
                f.SetAttribute("data/demo_1", "num_samples", 3);
              }),
              HasSubstr("data/demo_1/obs: lacks 'tip' of the first episode"));
  EXPECT_THAT(message([&](Hdf5File& f) {
                f.Write("data/demo_0/actions", rows(3));
                f.SetAttribute("data/demo_0", "outcome", std::string("won"));
              }),
              HasSubstr("data/demo_0: outcome 'won'"));
  EXPECT_THAT(message([&](Hdf5File& f) { f.CreateGroup("data/episode_1"); }),
              HasSubstr("data/episode_1: is not named demo_<number>"));
  EXPECT_THAT(message([&](Hdf5File& f) { f.SetAttribute("data", "env_args", std::string("{")); }),
              HasSubstr("env_args is not a JSON object"));
  EXPECT_THAT(message([&](Hdf5File& f) {
                f.SetAttribute("data", "provenance", std::string("origin=dreamt\n"));
              }),
              AllOf(HasSubstr("demos.hdf5"),
                    HasSubstr("must be unknown, simulated or real, not 'dreamt'")));
}

TEST(DemonstrationsTest, InvalidFilesAreRefusedByName) {
  const test::TempFolder folder;
  const auto message = [&](const char* name) {
    return test::MessageOf<std::runtime_error>([&] { (void)LoadRobomimic(folder / name); });
  };
  EXPECT_THAT(message("absent.hdf5"), AllOf(HasSubstr("absent.hdf5"), HasSubstr("no such file")));
  std::ofstream(folder / "text.hdf5") << "not HDF5";
  EXPECT_THAT(message("text.hdf5"), AllOf(HasSubstr("text.hdf5"), HasSubstr("cannot be opened")));
  { Hdf5File::Create(folder / "empty.hdf5"); }
  EXPECT_THAT(message("empty.hdf5"), HasSubstr("data: does not exist"));

  // For any truncation, the reader rejects or reads the file and never crashes.
  SaveRobomimic(Episodes(), folder / "whole.hdf5");
  const auto size = std::filesystem::file_size(folder / "whole.hdf5");
  for (std::uintmax_t cut = 0; cut < size; cut += size / 15) {
    std::filesystem::copy_file(folder / "whole.hdf5", folder / "cut.hdf5",
                               std::filesystem::copy_options::overwrite_existing);
    std::filesystem::resize_file(folder / "cut.hdf5", cut);
    EXPECT_THAT(message("cut.hdf5"), HasSubstr("cut.hdf5")) << "after " << cut << " bytes";
  }
  EXPECT_THAT(test::MessageOf<std::runtime_error>(
                  [&] { SaveRobomimic(Episodes(), folder / "no/demos.hdf5"); }),
              AllOf(HasSubstr("demos.hdf5"), HasSubstr("cannot be created")));
}

}  // namespace
}  // namespace dfr::imitation
