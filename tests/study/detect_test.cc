#include "apps/study/pictures/detect.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/sim/gallery/gallery.h"
#include "dfr/study/detectors.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::study {
namespace {

using testing::HasSubstr;

// Returns episodes with an alarm at step 2 of 4, at step 3, never, and at step 1.
std::vector<ScoredEpisode> Episodes() {
  return {{.scores = {0, 0, 5, 0, 0}, .failed = true},
          {.scores = {0, 0, 0, 9, 0, 0, 0}, .failed = true},
          {.scores = {0, 1, 1}, .failed = false},
          {.scores = {0, 7, 0, 0}, .failed = false}};
}

TEST(DetectorRatesTest, CountOnlyAlarmsUpToTheGivenStep) {
  const DetectorRates early = RatesOf(Episodes(), 2.0, 2);
  EXPECT_EQ(early.failures, 2);
  EXPECT_EQ(early.alarmed_failures, 1);
  EXPECT_EQ(early.successes, 2);
  EXPECT_EQ(early.alarmed_successes, 1);
  EXPECT_EQ(early.leads, std::vector<int>{2});
  EXPECT_EQ(early.balanced_accuracy(), 0.5);
  const DetectorRates late = RatesOf(Episodes(), 2.0, 3);
  EXPECT_EQ(late.leads, (std::vector<int>{2, 3}));
  EXPECT_EQ(late.balanced_accuracy(), 0.75);
  EXPECT_EQ(RatesOf({}, 2.0, 3).balanced_accuracy(), std::nullopt);
}

TEST(DetectorRatesTest, AThresholdIsAQuantileOfTheHighestScores) {
  std::vector<ScoredEpisode> demonstrations;
  for (int i = 1; i <= 19; ++i) {
    demonstrations.push_back({.scores = {0.0, static_cast<double>(i), 100.0}, .failed = false});
  }
  // The rank is ceil(20 * .9) = 18 of 19. Scores of step 2 do not count.
  EXPECT_EQ(CalibratedThreshold(demonstrations, 1, 0.1), 18.0);
  EXPECT_EQ(CalibratedThreshold(std::span(demonstrations).first(3), 1, 0.1), 3.0);
  EXPECT_THROW((void)CalibratedThreshold({}, 1, 0.1), std::invalid_argument);
}

imitation::DemonstrationSet Reach(int count) {
  const sim::GalleryTask& task = sim::FindGalleryTask("reach");
  return {.layout = task.plant->layout(),
          .control_dim = task.plant->control_dim(),
          .environment = task.name,
          .trajectories = sim::Demonstrate(task, count, 3),
          .note = {}};
}

TEST(DetectorTest, DistantStatesScoreHigherThanDemonstratedOnes) {
  const imitation::DemonstrationSet set = Reach(20);
  const FittedTask fit = FittedTask::Fit(set.layout, set.trajectories, "");
  const core::Matrix& near = set.trajectories[0].states;
  const core::Matrix far = near.array() + 5.0;
  for (const std::string_view name : kDetectors) {
    const auto detector = MakeDetector(name, fit, set, 1);
    const std::vector<double> low = detector->Scores(near);
    const std::vector<double> high = detector->Scores(far);
    ASSERT_EQ(std::ssize(low), near.rows()) << name;
    EXPECT_GT(*std::ranges::min_element(high), *std::ranges::max_element(low)) << name;
  }
  EXPECT_THROW((void)MakeDetector("magic", fit, set, 1), std::invalid_argument);
}

TEST(DetectTest, AFailingPolicyIsFound) {
  const Detection detection{
      .task = "reach", .policy = "at-constraints", .demonstrations = 20, .episodes = 6};
  const DetectionReport report = Detect(LoadDetection(detection), detection);
  ASSERT_EQ(report.table.rows.size(), kDetectors.size());
  for (const auto& row : report.table.rows) ASSERT_EQ(row.size(), report.table.header.size());
  EXPECT_EQ(report.table.rows[0][0], "guard");
  EXPECT_THAT(report.table.rows[0][3], testing::StartsWith("100 ["));
  EXPECT_THAT(report.text, HasSubstr("10 demonstrations fitted, 4 for thresholds, 6 left out"));
}

// Thirty entries are noisy mixtures of three numbers: almost no left-out state is inside.
TEST(DetectTest, TooManyFeaturesAreReducedWithAReason) {
  core::Random random(4);
  core::Matrix mixing(3, 30);
  for (Eigen::Index i = 0; i < mixing.size(); ++i) mixing.data()[i] = random.Normal();
  DetectionSet set;
  set.demonstrations.layout.Add("state\x1b", 30);
  set.demonstrations.control_dim = 3;
  for (int d = 0; d < 30; ++d) {
    core::Trajectory episode;
    core::Matrix low = core::Matrix::Zero(16, 3);
    episode.controls = core::Matrix::Zero(15, 3);
    for (Eigen::Index k = 0; k < 3; ++k) low(0, k) = 0.3 * random.Uniform();
    for (Eigen::Index t = 0; t < 15; ++t) {
      for (Eigen::Index k = 0; k < 3; ++k) episode.controls(t, k) = 0.1 * (1.0 - low(t, k));
      low.row(t + 1) = low.row(t) + episode.controls.row(t);
    }
    episode.states = low * mixing;
    for (Eigen::Index i = 0; i < episode.states.size(); ++i) {
      episode.states.data()[i] += 0.02 * random.Normal();
    }
    episode.outcome = core::Outcome::kCompleted;
    set.demonstrations.trajectories.push_back(std::move(episode));
  }
  const DetectionReport report = Detect(set, {});
  EXPECT_THAT(report.text, HasSubstr("refused: only "));
  EXPECT_THAT(report.text, HasSubstr("pca:state\\x1b"));
  set.demonstrations.trajectories.resize(9);
  EXPECT_THROW((void)Detect(set, {}), std::invalid_argument);
}

TEST(DetectTest, TheErrorForAMissingFileNamesSources) {
  EXPECT_THAT(
      dfr::test::MessageOf<std::runtime_error>(
          [&] { (void)LoadDetection({.files = {"nowhere.hdf5"}}); }),
      testing::AllOf(HasSubstr("nowhere.hdf5: no such file"), HasSubstr("D4RL/door/human-v2")));
}

TEST(DetectTest, SeveralFilesAreOneSetAndAnotherLayoutIsRefused) {
  const dfr::test::TempFolder folder;
  const imitation::DemonstrationSet set = Reach(6);
  const auto write = [&](const char* name, const core::StateLayout& layout) {
    imitation::RobomimicWriter writer(folder / name, layout, set.control_dim, "reach");
    for (const core::Trajectory& episode : set.trajectories) writer.Append(episode);
    return folder / name;
  };
  const auto first = write("first.hdf5", set.layout);
  const auto second = write("second.hdf5", set.layout);
  const DetectionSet loaded = LoadDetection({.files = {first, second}, .failures = second});
  EXPECT_EQ(loaded.demonstrations.trajectories.size(), 12U);
  EXPECT_EQ(loaded.demonstrations.trajectories[7].states, set.trajectories[1].states);
  EXPECT_EQ(loaded.further.size(), 6U);
  core::StateLayout other;
  other.Add("other", set.layout.state_dim());
  const auto third = write("third.hdf5", other);
  EXPECT_THAT(dfr::test::MessageOf<std::runtime_error>([&] {
                (void)LoadDetection({.files = {first, third}});
              }),
              HasSubstr("third.hdf5: states or actions differ"));
}

}  // namespace
}  // namespace dfr::study
