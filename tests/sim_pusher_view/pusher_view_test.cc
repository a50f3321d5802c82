#include "dfr/sim/pusher/pusher_view.h"

#include <dlfcn.h>
#include <gtest/gtest.h>

#include <array>
#include <cstdlib>
#include <stdexcept>
#include <string>
#include <vector>

namespace dfr::sim {
namespace {

using Picture = std::vector<std::uint8_t>;

constexpr int kWidth = 200;
constexpr int kHeight = 150;

Picture Draw(PusherRenderer& renderer, const PusherPlant& plant) {
  Picture rgb(3 * kWidth * kHeight);
  renderer.Draw(plant, rgb);
  return rgb;
}

// Centre and number of the pixels with a colour.
struct Blob {
  int pixels = 0;
  double column = 0.0;
  double row = 0.0;
};

template <typename Predicate>
Blob Find(const Picture& rgb, Predicate is_colour) {
  Blob blob;
  for (int row = 0; row < kHeight; ++row) {
    for (int column = 0; column < kWidth; ++column) {
      const std::uint8_t* p = &rgb[3 * static_cast<std::size_t>(row * kWidth + column)];
      if (!is_colour(p[0], p[1], p[2])) continue;
      ++blob.pixels;
      blob.column += column;
      blob.row += row;
    }
  }
  if (blob.pixels > 0) {
    blob.column /= blob.pixels;
    blob.row /= blob.pixels;
  }
  return blob;
}

bool IsGreen(int r, int g, int b) { return g > 90 && r < g / 2 && b < g / 2 + 20; }
bool IsRed(int r, int g, int b) { return r > 110 && g < r / 2 && b < r / 2; }

TEST(PusherViewTest, OverheadPictureShowsGoalAheadAndRedRegionsOnTheirSides) {
  PusherPlant plant;
  plant.Reset(1);
  PusherRenderer renderer(plant,
                          {.width = kWidth, .height = kHeight, .camera = PusherCamera::kOverhead});
  const Picture rgb = Draw(renderer, plant);
  const Blob goal = Find(rgb, IsGreen);
  const Blob red = Find(rgb, IsRed);
  EXPECT_GT(goal.pixels, 20);
  EXPECT_GT(red.pixels, 100);
  // The goal is on the symmetry axis in the upper half. The two regions are symmetric about the
  // axis.
  EXPECT_NEAR(goal.column, kWidth / 2.0, 3.0);
  EXPECT_LT(goal.row, kHeight / 2.0);
  EXPECT_NEAR(red.column, kWidth / 2.0, 3.0);
}

bool IsLoaded(const char* library) { return dlopen(library, RTLD_LAZY | RTLD_NOLOAD) != nullptr; }

// MuJoCo loads its functions from the first backend, which therefore stays for the process.
TEST(PusherViewTest, EqualStatesGiveEqualPicturesFromEveryRenderer) {
  PusherPlant plant;
  plant.Reset(1);
  const PusherRendererOptions size = {.width = kWidth, .height = kHeight};
  const char* wanted = std::getenv("DFR_GL");
  const std::string before = wanted == nullptr ? "" : wanted;
  Picture first;
  {
    PusherRenderer renderer(plant, size);
    first = Draw(renderer, plant);
    EXPECT_EQ(Draw(renderer, plant), first);
  }
  setenv("DFR_GL", before == "egl" ? "osmesa" : "egl", 1);
  PusherRenderer renderer(plant, size);
  setenv("DFR_GL", before.c_str(), 1);
  EXPECT_EQ(Draw(renderer, plant), first);
  EXPECT_EQ(IsLoaded("libEGL.so.1"), before == "egl");
  EXPECT_EQ(IsLoaded("libOSMesa.so.8"), before != "egl");
  const std::array<double, PusherPlant::kNumJoints> turn = {1.0};
  for (int i = 0; i < 4; ++i) ASSERT_EQ(plant.Apply(turn), core::PlantStatus::kOk);
  EXPECT_NE(Draw(renderer, plant), first);
}

TEST(PusherViewTest, RefusesASizeThatItCannotDraw) {
  const PusherPlant plant;
  EXPECT_THROW(PusherRenderer(plant, {.width = 8, .height = 480}), std::invalid_argument);
  EXPECT_THROW(PusherRenderer(plant, {.width = 640, .height = 5000}), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::sim
