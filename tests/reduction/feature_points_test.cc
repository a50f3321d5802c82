#include "dfr/reduction/feature_points.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <numeric>
#include <string>
#include <vector>

#include "dfr/core/files/archive.h"
#include "dfr/core/random.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"
#include "tests/support/temp_folder.h"

namespace dfr::reduction {
namespace {

using core::Matrix;
using testing::Each;
using testing::HasSubstr;
using testing::IsNan;

constexpr int kHeight = 9;
constexpr int kWidth = 12;
constexpr core::PictureShape kGrey = {kHeight, kWidth, 1};

// A picture of the mean value with a block of side x side pixels that is three deviations brighter.
std::vector<float> Bright(const core::PictureShape& shape, int row, int column, int side) {
  std::vector<float> picture(static_cast<std::size_t>(shape.height * shape.width * shape.channels),
                             128.0F);
  for (int y = row; y < row + side; ++y) {
    for (int i = column * shape.channels; i < (column + side) * shape.channels; ++i) {
      picture[static_cast<std::size_t>(y * shape.width * shape.channels + i)] += 3.0F * 48.0F;
    }
  }
  return picture;
}

std::vector<double> Positions(const FeaturePoints& points, const std::vector<float>& picture) {
  FeaturePoints::Workspace workspace(points);
  std::vector<double> positions(static_cast<std::size_t>(points.size()));
  points.Apply(picture, workspace, positions);
  return positions;
}

TEST(FeaturePointsTest, ABrightPatchIsLocated) {
  for (const int channels : {1, 3}) {
    const core::PictureShape shape = {kHeight, kWidth, channels};
    const FeaturePoints points(shape, 2, 50.0, Matrix::Constant(1, 4 * channels, 3.0));
    for (const auto& [row, column] : {std::pair(0, 0), {3, 5}, {kHeight - 2, kWidth - 2}}) {
      const std::vector<double> at = Positions(points, Bright(shape, row, column, 2));
      EXPECT_NEAR(at[0], column / (kWidth - 2.0), 1e-6);
      EXPECT_NEAR(at[1], row / (kHeight - 2.0), 1e-6);
    }
  }
}

TEST(FeaturePointsTest, PositionsAreWeightedMeans) {
  // A 1 x 1 patch of value 3 and a 1 x 3 picture with one bright pixel: the squared distance to the
  // patch is 9 in all windows except the last.
  const FeaturePoints points({1, 3, 1}, 1, 0.1, Matrix::Constant(1, 1, 3.0));
  const std::vector<double> at = Positions(points, Bright({1, 3, 1}, 0, 2, 1));
  const double others = std::exp(-0.1 * 9.0);
  EXPECT_NEAR(at[0], (0.5 * others + 1.0) / (2.0 * others + 1.0), 1e-6);
  EXPECT_EQ(at[1], 0.0);
}

Matrix RandomPictures(std::uint64_t seed, int count) {
  core::Random random(seed);
  Matrix pictures(count, kHeight * kWidth);
  for (double& value : pictures.reshaped()) value = random.Uniform(30.0, 220.0);
  return pictures;
}

// Computes the expected positions from the definition, in double.
TEST(FeaturePointsTest, AgreesWithTheDefinition) {
  const Matrix pictures = RandomPictures(1, 20);
  const FeaturePoints points =
      FeaturePoints::Fit(MatrixRows({&pictures, 1}), kGrey, {.points = 7, .side = 3});
  ASSERT_EQ(points.num_points(), 7);
  const Eigen::RowVectorXf row = pictures.row(4).cast<float>();
  const std::vector<double> at = Positions(points, {row.begin(), row.end()});
  for (int k = 0; k < points.num_points(); ++k) {
    double total = 0.0;
    double x = 0.0;
    double y = 0.0;
    for (int r = 0; r <= kHeight - 3; ++r) {
      for (int c = 0; c <= kWidth - 3; ++c) {
        double distance = 0.0;
        for (int i = 0; i < 9; ++i) {
          const double pixel = (pictures(4, (r + i / 3) * kWidth + c + i % 3) - 128.0) / 48.0;
          distance += std::pow(pixel - points.patches()(k, i), 2) / 9.0;
        }
        const double weight = std::exp(-5.0 * distance);
        total += weight;
        x += weight * c / (kWidth - 3.0);
        y += weight * r / (kHeight - 3.0);
      }
    }
    EXPECT_NEAR(at[static_cast<std::size_t>(2 * k)], x / total, 1e-4);
    EXPECT_NEAR(at[static_cast<std::size_t>(2 * k + 1)], y / total, 1e-4);
  }
}

TEST(FeaturePointsTest, PatchesAreWindowsOfThePictures) {
  // Stripes of one pixel have two kinds of windows.
  const core::PictureShape shape = {3, 8, 1};
  Matrix pictures(4, 24);
  for (Eigen::Index i = 0; i < pictures.size(); ++i) {
    pictures.data()[i] = i % 2 == 0 ? 128.0 : 128.0 + 48.0;
  }
  const FeaturePoints points =
      FeaturePoints::Fit(MatrixRows({&pictures, 1}), shape, {.points = 8, .side = 3});
  for (const double middle : {0.0, 1.0}) {
    Eigen::RowVectorXd window(9);
    for (int i = 0; i < 9; ++i) window[i] = i % 3 == 1 ? middle : 1.0 - middle;
    EXPECT_LT((points.patches().rowwise() - window).rowwise().norm().minCoeff(), 1e-9);
  }
}

TEST(FeaturePointsTest, ApplyAllocatesNothing) {
  const core::PictureShape shape = {12, FeaturePoints::kMostPixelsASide, 3};
  constexpr int kSide = FeaturePoints::kMostSide;
  const FeaturePoints points(shape, kSide, 5.0,
                             Matrix::Random(FeaturePoints::kMostPoints, kSide * kSide * 3));
  FeaturePoints::Workspace workspace(points);
  const std::vector<float> picture = Bright(shape, 5, 6, 7);
  std::vector<double> positions(static_cast<std::size_t>(points.size()));
  const test::NoAlloc guard;
  points.Apply(picture, workspace, positions);
}

TEST(FeaturePointsTest, AnInvalidPictureHasNoPosition) {
  const FeaturePoints points(kGrey, 2, 5.0, Matrix::Constant(2, 4, 3.0));
  std::vector<float> picture = Bright(kGrey, 1, 1, 2);
  picture[17] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THAT(Positions(points, picture), Each(IsNan()));
  picture[17] = std::numeric_limits<float>::infinity();
  EXPECT_THAT(Positions(points, picture), Each(IsNan()));
  picture = Bright(kGrey, 1, 1, 2);
  picture.pop_back();
  EXPECT_THAT(Positions(points, picture), Each(IsNan()));
}

TEST(FeaturePointsTest, SharesGoToThePixelsOfThePatch) {
  const FeaturePoints points(kGrey, 2, 50.0, Matrix::Constant(1, 4, 3.0));
  FeaturePoints::Workspace workspace(points);
  std::vector<double> positions(2);
  points.Apply(Bright(kGrey, 4, 6, 2), workspace, positions);
  std::vector<double> pixels(kHeight * kWidth, 0.0);
  points.Spread(std::vector{2.0}, workspace, pixels);
  EXPECT_NEAR(std::accumulate(pixels.begin(), pixels.end(), 0.0), 2.0, 1e-9);
  EXPECT_NEAR(pixels[4 * kWidth + 6], 0.5, 1e-6);
  EXPECT_NEAR(pixels[5 * kWidth + 7], 0.5, 1e-6);
}

TEST(FeaturePointsTest, OptionsOutOfRangeAreNamed) {
  const auto message = [](const core::PictureShape& shape, int side, double sharpness,
                          const Matrix& patches) {
    return test::MessageOf([&] { FeaturePoints(shape, side, sharpness, patches); });
  };
  const Matrix patch = Matrix::Ones(1, 4);
  EXPECT_THAT(message(kGrey, 8, 5.0, patch), HasSubstr("side of a patch must lie in [1, 7]"));
  EXPECT_THAT(message({1, 9, 1}, 2, 5.0, patch),
              HasSubstr("need pictures of 2 to 128 pixels a side, not 1 x 9"));
  EXPECT_THAT(message({9, 129, 1}, 2, 5.0, patch), HasSubstr("not 9 x 129"));
  EXPECT_THAT(message({9, 9, 2}, 2, 5.0, patch), HasSubstr("channels must be 1 or 3, not 2"));
  EXPECT_THAT(message(kGrey, 3, 5.0, patch), HasSubstr("4 entries, not 3 x 3 x 1"));
  EXPECT_THAT(message(kGrey, 2, 0.0, patch), HasSubstr("sharpness must lie in"));
  EXPECT_THAT(message(kGrey, 2, std::nan(""), patch), HasSubstr("sharpness must lie in"));
  EXPECT_THAT(message(kGrey, 2, 5.0, 2e6 * patch), HasSubstr("must be finite and within"));
  EXPECT_THAT(message(kGrey, 2, 5.0, std::nan("") * patch), HasSubstr("must be finite"));
  EXPECT_THAT(message(kGrey, 2, 5.0, Matrix::Ones(65, 4)), HasSubstr("must lie in [1, 64]"));
  const Matrix plain = Matrix::Constant(3, kHeight * kWidth, 50.0);
  EXPECT_THAT(test::MessageOf([&] {
                static_cast<void>(FeaturePoints::Fit(MatrixRows({&plain, 1}), kGrey));
              }),
              HasSubstr("have a single colour"));
}

// OptionsOutOfRangeAreNamed tests all values.
TEST(FeaturePointsTest, HostileFilesAreRefusedByName) {
  const std::filesystem::path path = dfr::test::ProcessFolder() / "feature_points_test.dfr";
  const auto message = [&](int side, double sharpness, const Matrix& patches) {
    core::ArchiveWriter writer("test", 1);
    writer.Integer(side);
    writer.Number(sharpness);
    writer.MatrixBlock(patches);
    writer.Save(path);
    core::ArchiveReader reader(path, "test", 1);
    return test::MessageOf([&] { static_cast<void>(FeaturePoints::Load(reader, kGrey)); });
  };
  EXPECT_EQ(message(2, 5.0, Matrix::Ones(3, 4)), "nothing thrown");
  EXPECT_THAT(message(0, 5.0, Matrix::Ones(3, 4)), HasSubstr("feature_points_test.dfr"));
  EXPECT_THAT(message(2, -1.0, Matrix::Ones(3, 4)),
              HasSubstr("holds no feature points: sharpness"));
  EXPECT_THAT(message(2, 5.0, Matrix::Ones(0, 4)), HasSubstr("number of points"));
  std::filesystem::remove(path);
}

}  // namespace
}  // namespace dfr::reduction
