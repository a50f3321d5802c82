#include "dfr/sim/gallery/canvas.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <vector>

#include "dfr/sim/gallery/gallery.h"

namespace dfr::sim {
namespace {

// Red channel of a picture of 4 x 4 pixels of size 1, on a background of 100.
class CanvasTest : public testing::Test {
 protected:
  CanvasTest() : canvas_(rgb_, 4, 0.0, 0.0, 4.0) { canvas_.Fill({100, 50, 25}); }
  [[nodiscard]] std::vector<int> Reds() const {
    std::vector<int> reds;
    for (std::size_t i = 0; i < rgb_.size(); i += 3) reds.push_back(rgb_[i]);
    return reds;
  }
  std::vector<std::uint8_t> rgb_ = std::vector<std::uint8_t>(48);
  Canvas canvas_;
};

TEST_F(CanvasTest, ABoxCoversAQuarterOfThePixelsAtItsEdge) {
  canvas_.Box(2.0, 3.0, 1.25, 1.0, 0.0, {200, 50, 25});
  EXPECT_EQ(Reds(), (std::vector<int>{125, 200, 200, 125,  //
                                      125, 200, 200, 125,  //
                                      100, 100, 100, 100,  //
                                      100, 100, 100, 100}));
  EXPECT_EQ(rgb_[1], 50);
  EXPECT_EQ(rgb_[2], 25);
}

// The distance of the diagonal neighbour is sqrt(2) - 1: 8.6 % are covered.
TEST_F(CanvasTest, ADiscCoversByDistance) {
  canvas_.Disc(0.5, 3.5, 1.0, {200, 50, 25});
  EXPECT_EQ(Reds(), (std::vector<int>{200, 150, 100, 100,  //
                                      150, 109, 100, 100,  //
                                      100, 100, 100, 100,  //
                                      100, 100, 100, 100}));
}

TEST_F(CanvasTest, ASegmentHasRoundEnds) {
  canvas_.Segment(1.5, 0.5, 2.5, 0.5, 0.75, {200, 50, 25});
  EXPECT_EQ(Reds(), (std::vector<int>{100, 100, 100, 100,  //
                                      100, 100, 100, 100,  //
                                      100, 125, 125, 100,  //
                                      125, 200, 200, 125}));
}

TEST_F(CanvasTest, ATurnByARightAngleSwapsTheSides) {
  std::vector<std::uint8_t> other(48);
  Canvas swapped(other, 4, 0.0, 0.0, 4.0);
  swapped.Fill({100, 50, 25});
  swapped.Box(2.0, 2.0, 0.5, 1.5, 0.0, {200, 50, 25});
  canvas_.Box(2.0, 2.0, 1.5, 0.5, 1.5707963267948966, {200, 50, 25});
  EXPECT_EQ(rgb_, other);
}

Colour At(const std::vector<std::uint8_t>& rgb, int row, int column) {
  const auto i =
      std::size_t{3} * static_cast<std::size_t>(GalleryPlant::kPictureSide * row + column);
  return {rgb[i], rgb[i + 1], rgb[i + 2]};
}

std::vector<std::uint8_t> PictureOf(const std::string& task, const std::vector<double>& state) {
  std::vector<std::uint8_t> rgb(3u * GalleryPlant::kPictureSide * GalleryPlant::kPictureSide);
  EXPECT_TRUE(FindGalleryTask(task).plant->Draw(state, rgb));
  return rgb;
}

// A pixel of the task reach is 0.025 wide. The left edge is at -0.3 and the top at 0.8.
TEST(GalleryPictureTest, ReachShowsPointPillarAndGoal) {
  const auto rgb = PictureOf("reach", {0.0, 0.25});
  const Colour ground = At(rgb, 0, 0);
  const Colour robot = At(rgb, 22, 12);
  const Colour pillar = At(rgb, 32, 34);
  const Colour goal = At(rgb, 32, 52);
  EXPECT_NE(robot, ground);
  EXPECT_EQ(At(rgb, 21, 11), robot);
  EXPECT_EQ(At(rgb, 32, 12), ground);  // position of a point at (0, 0)
  EXPECT_EQ(At(rgb, 25, 34), pillar);
  EXPECT_EQ(At(rgb, 22, 34), ground);
  EXPECT_NE(goal, pillar);
  EXPECT_NE(goal, ground);
}

TEST(GalleryPictureTest, EachEntryOfAStateChangesThePictureOfItsTask) {
  for (const char* name :
       {"reach", "two-ways", "passage", "goal", "push", "insertion", "grasp", "door"}) {
    const GalleryTask& task = FindGalleryTask(name);
    const core::Trajectory shown = DemonstrateOnce(task, 1);
    for (Eigen::Index i = 0; i < shown.states.cols(); ++i) {
      const double range = shown.states.col(i).maxCoeff() - shown.states.col(i).minCoeff();
      if (range < 0.02) continue;
      std::vector<double> first(shown.states.row(0).begin(), shown.states.row(0).end());
      const auto before = PictureOf(name, first);
      first[static_cast<std::size_t>(i)] += 0.5 * range;
      EXPECT_NE(PictureOf(name, first), before) << name << " " << i;
    }
  }
}

TEST(GalleryPictureTest, OtherTasksHaveNoPicture) {
  std::vector<std::uint8_t> rgb(3u * GalleryPlant::kPictureSide * GalleryPlant::kPictureSide);
  EXPECT_FALSE(FindGalleryTask("balance").plant->Draw(std::vector<double>(8), rgb));
}

}  // namespace
}  // namespace dfr::sim
