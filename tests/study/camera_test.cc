#include "apps/study/pictures/camera.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>
#include <string>
#include <vector>

#include "apps/study/study.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"

namespace dfr::study {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

constexpr int kSide = Camera::kSide;

std::vector<double> PictureWith(const Nuisances& nuisances, std::uint64_t seed) {
  Camera camera(sim::FindGalleryTask("reach").plant, nuisances);
  camera.Reset(seed);
  std::vector<double> picture(Camera::kSize);
  camera.See(std::vector<double>{0.1, 0.2}, picture);
  return picture;
}

int NumDifferent(const std::vector<double>& a, const std::vector<double>& b) {
  int different = 0;
  for (std::size_t i = 0; i < a.size(); ++i) different += a[i] != b[i] ? 1 : 0;
  return different;
}

TEST(CameraTest, WithoutNuisancesShowsWhatIsDrawn) {
  std::vector<std::uint8_t> drawn(Camera::kSize);
  ASSERT_TRUE(sim::FindGalleryTask("reach").plant->Draw(std::vector<double>{0.1, 0.2}, drawn));
  EXPECT_EQ(PictureWith({}, 1), std::vector<double>(drawn.begin(), drawn.end()));
}

TEST(CameraTest, LightScalesAllPixels) {
  const auto plain = PictureWith({}, 1);
  const auto lit = PictureWith({.light = 0.1}, 1);
  const double gain = lit[0] / plain[0];
  EXPECT_NE(gain, 1.0);
  for (std::size_t i = 0; i < lit.size(); ++i) EXPECT_NEAR(lit[i], gain * plain[i], 1.1);
}

TEST(CameraTest, NoiseHasItsDeviation) {
  const auto plain = PictureWith({}, 1);
  const auto noisy = PictureWith({.noise = 0.03}, 1);
  double squares = 0.0;
  int count = 0;
  for (std::size_t i = 0; i < plain.size(); ++i) {
    if (plain[i] > 215.0) continue;  // clipped at 255
    squares += (noisy[i] - plain[i]) * (noisy[i] - plain[i]);
    ++count;
  }
  EXPECT_NEAR(squares / count, 7.65 * 7.65, 3.0);
}

TEST(CameraTest, AShiftMovesEveryPixelByOne) {
  const auto plain = PictureWith({}, 1);
  const auto shifted = PictureWith({.shift = 1}, 1);
  const auto fits = [&](int columns, int rows) {
    for (int row = 1; row + 1 < kSide; ++row) {
      for (int i = 3; i + 3 < 3 * kSide; ++i) {
        const int to = 3 * kSide * row + i;
        const int from = 3 * kSide * (row - rows) + i - 3 * columns;
        if (shifted[static_cast<std::size_t>(to)] != plain[static_cast<std::size_t>(from)]) {
          return false;
        }
      }
    }
    return true;
  };
  EXPECT_EQ(fits(1, 0) + fits(-1, 0) + fits(0, 1) + fits(0, -1), 1);
}

TEST(CameraTest, ADistractorAndAnOcclusionChangeAPart) {
  const auto plain = PictureWith({}, 1);
  const int disc = NumDifferent(plain, PictureWith({.distractor = true}, 1));
  EXPECT_GT(disc, 0);
  EXPECT_LE(disc, 3 * 81);  // a radius of 4 pixels, with an edge of half a pixel
  const int hidden = NumDifferent(plain, PictureWith({.occlusion = true}, 1));
  EXPECT_EQ(hidden, 3 * (kSide / 3) * (kSide / 3));
}

TEST(CameraTest, SeesWithoutAllocation) {
  Camera camera(sim::FindGalleryTask("push").plant,
                {.light = 0.2, .noise = 0.03, .distractor = true, .shift = 1, .occlusion = true});
  const std::vector<double> state(5);
  std::vector<double> picture(Camera::kSize);
  const test::NoAlloc guard;
  camera.Reset(3);
  camera.See(state, picture);
}

TEST(CameraTest, ATaskWithoutPicturesIsRefused) {
  EXPECT_THROW(Camera(sim::FindGalleryTask("balance").plant, {}), std::invalid_argument);
}

Study Pictured(int threads) {
  Study study = Study::OfGuards();
  study.tasks = {"reach"};
  study.policies = {"weak"};
  study.controllers = {"monitor/pictures", "guard/pictures"};
  study.conditions = {"as demonstrated", "picture disturbed"};
  study.pictures.features = "pca:image:3:grey:16x16";
  study.demonstrations = 8;
  study.episodes = 2;
  study.trials = 1;
  study.seed = 3;
  study.threads = threads;
  return study;
}

// A monitor on pictures passes every action: its episodes equal the episodes of the policy alone.
// The second condition disturbs only the pictures, which the policy does not receive.
TEST(PicturedGuardsTest, MonitorsChangeNothingAndThreadsDoNotMatter) {
  const std::vector<Row> rows = RunStudy(Pictured(1));
  ASSERT_EQ(rows.size(), 6u);
  for (const std::size_t i : {1u, 3u, 4u}) {
    EXPECT_EQ(rows[i].completed, rows[0].completed);
    EXPECT_EQ(rows[i].collided, rows[0].collided);
    EXPECT_EQ(rows[i].controls, rows[0].controls);
  }
  EXPECT_GT(rows[2].changed, 0.0);
  EXPECT_TRUE(rows == RunStudy(Pictured(2)));
}

// Without a guard on pictures, disturbed pictures would have no effect.
TEST(PicturedGuardsTest, NeedFeaturesAndTasksWithPictures) {
  const auto error = [](const auto& change) {
    Study study = Pictured(1);
    change(study);
    return dfr::test::MessageOf<std::invalid_argument>([&] { static_cast<void>(RunStudy(study)); });
  };
  EXPECT_THAT(error([](Study& study) { study.pictures.features.clear(); }),
              AllOf(HasSubstr("'monitor/pictures' needs pictures"), HasSubstr("--pictures")));
  EXPECT_THAT(error([](Study& study) {
                study.controllers = {"guard"};
                study.conditions = {"picture shifted"};
                study.pictures.features.clear();
              }),
              AllOf(HasSubstr("'picture shifted'"), HasSubstr("--pictures")));
  EXPECT_THAT(error([](Study& study) {
                study.tasks = {"reach", "balance"};
              }),
              AllOf(HasSubstr("'balance'"), HasSubstr("two-ways"), HasSubstr("door"),
                    Not(HasSubstr("inertia"))));
}

}  // namespace
}  // namespace dfr::study
