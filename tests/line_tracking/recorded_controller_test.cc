// Recordings of runs, and files that a run rejects.
#include "recorded_controller.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <stdexcept>
#include <string>

#include "commands/commands.h"
#include "dfr/recording/read_recording.h"
#include "tests/line_tracking/model_folder.h"
#include "tests/support/message_of.h"

namespace dfr::apps::line_tracking {
namespace {

TEST(RunTest, ASimulatedModelDrivesNoRobot) {
  RunOptions options;
  options.config = Data().path / "robot.toml";
  std::ofstream(options.config) << "robot = 'dds'\nmodel = '" << (Data().path / "model").string()
                                << "'\n[arm]\nserial = 'A7'\n[camera]\nname = 'left eye'\n";
  EXPECT_THAT(dfr::test::MessageOf<std::runtime_error>([&] { RunRun(options); }),
              testing::AllOf(testing::HasSubstr("model: its origin is 'simulated'"),
                             testing::HasSubstr("fit again")));
}

TEST(RunTest, ItsRecordingTellsWhetherAnEmergencyStopWasRequired) {
  RobotConfig config;
  config.model = Data().path / "model";
  EXPECT_TRUE(RunMetadata(config, 1).more.empty()) << "nothing real moves";
  config.robot = RobotPlace::kDds;
  EXPECT_EQ(RunMetadata(config, 1).more.at("emergency stop"), "required");
  config.emergency_stop = false;
  EXPECT_EQ(RunMetadata(config, 1).more.at("emergency stop"), "none");
}

TEST(RecordedControllerTest, AReplayRepeatsAllDecisionsAndDetectsADifference) {
  const std::filesystem::path path = Data().path / "run.mcap";
  const std::filesystem::path folder = Data().path / "model";
  const LineModel model = LineModel::Load(folder);
  recording::RecordingMetadata metadata;
  metadata.model = folder.string();
  metadata.model_checksum = recording::Checksum(folder);
  metadata.method = "controller";
  metadata.commit = "0123456789ab\x1b[2J";
  const line_task::LineCalibration known = Data().Calibration();
  sim::LineTrackingPlant plant(FromTruth(), &known);
  {
    recording::Recorder recorder(path, metadata);
    const std::unique_ptr<control::Controller> guided = model.MakeController("controller");
    RecordedController controller(*guided, &recorder);
    controller.BeginEpisode(0);
    static_cast<void>(Episode(plant, controller, 0));
    recorder.Finish();
  }
  const recording::Recording log = recording::ReadRecording(path);
  EXPECT_GT(log.steps.size(), 20U);
  EXPECT_EQ(log.steps.front().state.view().size(), 4U);
  testing::internal::CaptureStdout();
  EXPECT_TRUE(ReplayRecording(path, {}));
  // If methods have changed since the recording, the replay prints why decisions may differ.
  // Text in the recording does not control the terminal.
  EXPECT_THAT(testing::internal::GetCapturedStdout(),
              testing::AllOf(testing::HasSubstr("this program is of commit "),
                             testing::HasSubstr("commit 0123456789ab\\x1b[2J\n")));

  // Another model makes other decisions.
  const std::filesystem::path elsewhere = Data().path / "other";
  LineModelOptions other;
  other.hidden = {4};
  other.gammas = {0.2};
  LineModel::Fit(Demonstrations(), other).Save(elsewhere);
  EXPECT_FALSE(ReplayRecording(path, elsewhere));
}

// Without decisions, a replay could find no difference.
TEST(RecordedControllerTest, ARecordingWithoutDecisionsIsNotReplayed) {
  const std::filesystem::path path = Data().path / "empty.mcap";
  recording::RecordingMetadata metadata;
  metadata.model = (Data().path / "model").string();
  metadata.model_checksum = recording::Checksum(Data().path / "model");
  metadata.method = "controller";
  recording::Recorder(path, metadata).Finish();
  EXPECT_THAT(dfr::test::MessageOf<std::runtime_error>(
                  [&] { static_cast<void>(ReplayRecording(path, {})); }),
              testing::HasSubstr("empty.mcap contains no decision"));
}

}  // namespace
}  // namespace dfr::apps::line_tracking
