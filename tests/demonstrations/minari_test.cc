#include "dfr/imitation/minari.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <exception>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <limits>
#include <string>

#include "episode_io.h"
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

void Save(const DemonstrationSet& set, const std::filesystem::path& folder) {
  internal::WriteAll(set, [&] {
    return MinariWriter(folder, "dfr/test-v0", set.layout, set.control_dim, set.environment);
  });
}

std::string Message(const std::function<void()>& call) {
  return test::MessageOf<std::exception>(call);
}

class MinariTest : public testing::TestWithParam<bool> {};

TEST_P(MinariTest, ADatasetRestoresEverything) {
  const test::TempFolder folder;
  DemonstrationSet set = Episodes(GetParam());
  if (!GetParam()) {
    set.layout.blocks[0].name = "goal/tip";
    set.layout.blocks[2].name = "goal/angle";
  }
  Save(set, folder / "test-v0");
  for (const char* path : {"test-v0", "test-v0/data", "test-v0/data/main_data.hdf5"}) {
    const DemonstrationSet loaded = LoadDemonstrations(folder / path);
    test::ExpectSame(loaded, set);
  }
  if (GetParam()) return;
  // Minari expects a space of spaces for a group of datasets.
  const std::string box = R"({\"type\": \"Box\", \"dtype\": \"float64\", \"shape\": [)";
  const std::string dict = R"({\"type\": \"Dict\", \"subspaces\": {)";
  std::ifstream in(folder / "test-v0/data/metadata.json");
  const std::string metadata{std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
  EXPECT_THAT(metadata, HasSubstr(dict + R"(\"goal\": )" + dict + R"(\"tip\": )" + box + "3]"));
  EXPECT_THAT(metadata, HasSubstr(R"(, \"angle\": )" + box + "1]"));
  EXPECT_THAT(metadata, HasSubstr(R"(}}, \"object\": )" + box + "2]"));
}

TEST_P(MinariTest, AnIndependentReaderFindsEveryValue) {
  const test::TempFolder folder;
  Save(Episodes(GetParam()), folder / "test-v0");
  test::RunPeer("minari_peer.py", GetParam() ? "check-plain" : "check", folder / "test-v0");
}

TEST_P(MinariTest, ADatasetOfAnIndependentWriterIsRead) {
  const test::TempFolder folder;
  test::RunPeer("minari_peer.py", GetParam() ? "write-plain" : "write", folder / "lift-v0");
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
      test::ExpectStatesByName(actual.states, expected.states);
    }
    EXPECT_EQ(actual.controls, expected.controls);  // sixteenths are exact in float32
    EXPECT_EQ(actual.outcome, i == 2 ? Outcome::kCompleted : Outcome::kHalted);
    EXPECT_EQ(actual.seed, i == 1 ? 0u : 70u + static_cast<unsigned>(i));  // 0: unknown
  }
}

INSTANTIATE_TEST_SUITE_P(Observations, MinariTest, testing::Bool(),
                         [](const auto& instance) { return instance.param ? "Plain" : "Named"; });

TEST(MinariErrorsTest, NameTheDatasetAndTheReason) {
  const test::TempFolder folder;
  Save(Episodes(false), folder / "d");
  const std::filesystem::path file = folder / "d/data/main_data.hdf5";
  const auto broken = [&](const std::function<void(Hdf5File&)>& build) {
    {
      Hdf5File f = Hdf5File::Create(folder / "broken.hdf5");
      f.CreateGroup("episode_0");
      build(f);
    }
    return Message([&] { (void)OpenMinari(folder / "broken.hdf5")->Read(0); });
  };
  const core::Matrix four = core::Matrix::Ones(4, 2);
  const core::Matrix three = core::Matrix::Ones(3, 2);
  const auto with = [&](const core::Matrix& observations) {
    return broken([&](auto& f) {
      f.Write("episode_0/observations", observations);
      f.Write("episode_0/actions", three);
    });
  };
  EXPECT_THAT(broken([](auto&) {}),
              AllOf(HasSubstr("broken.hdf5"), HasSubstr("episode_0/observations: does not exist")));
  EXPECT_THAT(broken([&](auto& f) { f.Write("episode_0/observations", four); }),
              HasSubstr("episode_0/actions: does not exist"));
  EXPECT_THAT(with(three),
              HasSubstr("observations: has 3 rows; the number of actions plus one is 4"));
  core::Matrix bad = four;
  bad(2, 1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(with(bad), HasSubstr("episode_0/observations: row 2, column 1 is nan"));
  EXPECT_THAT(broken([&](auto& f) {
                f.Write("episode_0/observations", four);
                f.Write("episode_0/actions", three);
                f.SetAttribute("episode_0", "total_steps", 7);
              }),
              HasSubstr("episode_0: total_steps is 7, but there are 3 actions"));
  std::filesystem::create_directories(folder / "empty");
  EXPECT_THAT(Message([&] { (void)OpenDemonstrations(folder / "empty"); }),
              HasSubstr("has neither data/main_data.hdf5"));
  EXPECT_THAT(Message([&] { (void)OpenDemonstrations(folder / "absent"); }),
              HasSubstr("no such file"));

  // The data are readable, and only the metadata are wrong.
  const std::filesystem::path metadata = folder / "m/data/metadata.json";
  Save(Episodes(false), folder / "m");
  const auto with_metadata = [&](const std::string& text) {
    std::ofstream(metadata) << text;
    return Message([&] { (void)OpenMinari(folder / "m"); });
  };
  EXPECT_THAT(with_metadata("[1]"), AllOf(HasSubstr("metadata.json"), HasSubstr("JSON object")));
  EXPECT_THAT(with_metadata(R"({"data_format": "arrow"})"),
              HasSubstr("data_format is 'arrow'; only hdf5 can be read"));
  EXPECT_THAT(with_metadata(R"({"data_format": 5})"),
              AllOf(HasSubstr("metadata.json"), HasSubstr("data_format is not a string")));
  EXPECT_THAT(with_metadata(R"({"dataset_id": ["a"]})"), HasSubstr("dataset_id is not a string"));
  EXPECT_THAT(with_metadata(R"({"env_spec": "{\"id\": 1}"})"), HasSubstr("id is not a string"));

  DemonstrationSet beyond = Episodes(false);
  beyond.trajectories[2].controls(7, 1) = 1.5;
  EXPECT_THAT(Message([&] { Save(beyond, folder / "d"); }),
              HasSubstr("demonstration 2, step 7: control 1 is 1.5"));
  EXPECT_EQ(OpenMinari(file)->num_episodes(), 3);  // the existing file is unchanged
}

}  // namespace
}  // namespace dfr::imitation
