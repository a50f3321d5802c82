#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <iterator>
#include <opencv2/core.hpp>
#include <opencv2/videoio.hpp>
#include <stdexcept>

#include "apps/study/planar/coverage.h"
#include "apps/study/planar/methods.h"
#include "apps/study/planar/picture.h"
#include "apps/study/planar/proof.h"
#include "apps/study/planar/task.h"
#include "apps/study/study.h"
#include "apps/video_writer.h"
#include "dfr/core/files/atomic_file.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::study::planar {
namespace {

TEST(PlanarTest, ResultsDoNotDependOnTheNumberOfThreads) {
  Study study = Study::OfPlane();
  study.tasks = {"planar-push"};
  study.controllers = {"dfr", "controller"};
  study.demonstrations = 20;
  study.trials = 2;
  study.episodes = 3;
  study.seed = 11;
  study.threads = 1;
  const auto one = RunStudy(study);
  study.threads = 2;
  EXPECT_TRUE(one == RunStudy(study));
}

// Methods with other supports stay comparable.
TEST(PlanarTest, StartsDoNotDependOnTheOptionsOfMethods) {
  Study study = Study::OfPlane();
  study.tasks = {"planar-push-weak"};
  study.controllers = {};
  study.demonstrations = 20;
  study.trials = 1;
  study.episodes = 40;
  const auto rows = RunStudy(study);
  study.plane.phase_whitening = false;
  study.plane.raw_gamma = 50.0;
  study.plane.gamma = 2.0;
  EXPECT_TRUE(rows == RunStudy(study));
}

// The system tier runs longer and tests every mutation.
TEST(ProofTest, StaysInsideTheUnionOfSupports) {
  for (const double error : {0.0, 0.05}) {
    SCOPED_TRACE(error);
    const ProofResult result = Prove({.steps = 2000, .state_error = error});
    EXPECT_EQ(result.controls, 2000);
    EXPECT_EQ(result.left, 0);
    EXPECT_EQ(result.violations, 0);
    EXPECT_GT(result.probes, 5);
    EXPECT_GT(result.phases, 4);
  }
}

TEST(CoverageTest, UnknownWorldsAreRefused) {
  EXPECT_THROW((void)MeasureCoverage({.world = "moon"}), std::invalid_argument);
}

TEST(PlanarTest, EveryMethodRunsAndUnknownNamesAreNamed) {
  const Task task = MakeTask("push");
  const Methods methods(task, Demonstrate(task, 20, 1));
  for (const auto& name : {"baseline", "early-stopping", "dfr", "finite-difference",
                           "true-jacobian", "lwr", "ensemble", "dart", "dagger", "controller",
                           "controller-without-filter+exit-level", "certified-direction"}) {
    EXPECT_EQ(methods.Make(name, *task.plant)->state_dim(), 4) << name;
  }
  EXPECT_THROW((void)methods.Make("magic", *task.plant), std::invalid_argument);
  EXPECT_THROW((void)methods.Make("controller-without-magic", *task.plant), std::invalid_argument);
  EXPECT_THROW((void)methods.Make("certified-direction@lwr", *task.plant), std::invalid_argument);
  EXPECT_THROW((void)MakeTask("magic"), std::invalid_argument);
}

TEST(PlanarTest, PicturesShowTheSupportThatAMethodUses) {
  for (const char* name : {"guard", "controller@lwr", "true-jacobian", "certified-direction"}) {
    EXPECT_EQ(SupportOf(name), SupportKind::kGuided) << name;
  }
  for (const char* name : {"baseline", "early-stopping", "dfr@lwr", "finite-difference"}) {
    EXPECT_EQ(SupportOf(name), SupportKind::kRaw) << name;
  }
  EXPECT_THROW((void)SupportOf("dfr/density"), std::invalid_argument);
}

TEST(VideoWriterTest, WritesEvenSizesAndRefusesOtherEndings) {
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("dfr_video_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  const cv::Mat picture(49, 65, CV_8UC3, cv::Scalar(20, 120, 220));
  {
    apps::VideoWriter writer(folder / "odd.webm", picture.size(), 10.0);
    for (int i = 0; i < 3; ++i) writer.Write(picture);
    writer.Commit();
  }
  cv::VideoCapture video((folder / "odd.webm").string(), cv::CAP_FFMPEG);
  cv::Mat read;
  ASSERT_TRUE(video.read(read));
  EXPECT_EQ(read.size(), cv::Size(64, 48));
  const auto message = [&](const char* name) {
    return dfr::test::MessageOf<std::runtime_error>([&] {
      apps::VideoWriter(folder / name, {64, 48}, 10.0);
    });
  };
  EXPECT_THAT(message("video.gif"), testing::HasSubstr("must end in .mp4 or .webm"));
  EXPECT_THAT(message("no/video.mp4"), testing::HasSubstr("no/video.mp4: cannot be created"));
  std::filesystem::remove_all(folder);
}

TEST(VideoWriterTest, AnIncompleteVideoLeavesThePreviousFile) {
  const test::TempFolder folder;
  const std::filesystem::path file = folder / "video.webm";
  core::ReplaceFile(file, "previous");
  {
    apps::VideoWriter writer(file, {64, 48}, 10.0);
    for (int i = 0; i < 3; ++i) writer.Write(cv::Mat::zeros(48, 64, CV_8UC3));
    EXPECT_EQ(test::FileText(file), "previous");
  }
  EXPECT_EQ(test::FileText(file), "previous");
  const std::filesystem::directory_iterator files(folder.path);
  EXPECT_EQ(std::distance(begin(files), end(files)), 1);
}

// Under a limit on the size of files, writing fails as on a full disk.
TEST(VideoWriterTest, AFullDiskLeavesThePreviousFile) {
  const test::TempFolder folder;
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  for (const char* name : {"video.webm", "video.mp4"}) {
    SCOPED_TRACE(name);
    const std::filesystem::path file = folder / name;
    core::ReplaceFile(file, "previous");
    const rlimit small{20'000, before.rlim_max};
    ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
    const std::string message = test::MessageOf<std::runtime_error>([&] {
      apps::VideoWriter writer(file, {320, 240}, 10.0);
      cv::Mat noise(240, 320, CV_8UC3);
      for (int i = 0; i < 20; ++i) {
        cv::randu(noise, 0, 255);
        writer.Write(noise);
      }
      writer.Commit();
    });
    ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &before), 0);
    EXPECT_THAT(message, testing::HasSubstr(std::string(name) + ": the video is incomplete"));
    EXPECT_EQ(test::FileText(file), "previous");
  }
  std::signal(SIGXFSZ, handler);
}

}  // namespace
}  // namespace dfr::study::planar
