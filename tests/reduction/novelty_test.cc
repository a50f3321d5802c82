#include "dfr/reduction/novelty.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "dfr/core/files/archive.h"
#include "dfr/core/random.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"
#include "tests/support/temp_folder.h"

namespace dfr::reduction {
namespace {

using core::Matrix;
using testing::HasSubstr;

constexpr core::PictureShape kShape{4, 5, 1};
constexpr int kPixels = 20;

struct Seen {
  std::vector<Matrix> pictures;
  std::vector<Matrix> positions;
  std::vector<Eigen::Index> begin{0};
};

// Pixels have mean 100 and deviation 10. Two positions have a sum that varies little.
Seen Demonstrations(std::uint64_t seed, int count) {
  core::Random random(seed);
  Seen seen;
  for (int d = 0; d < count; ++d) {
    Matrix pictures(12, kPixels);
    for (double& value : pictures.reshaped()) value = 100.0 + 10.0 * random.Normal();
    Matrix positions(12, 2);
    for (Eigen::Index i = 0; i < 12; ++i) {
      const double way = 0.2 * random.Normal();
      positions.row(i) << 0.5 + way, 0.5 - way + 0.01 * random.Normal();
    }
    seen.begin.push_back(seen.begin.back() + pictures.rows());
    seen.pictures.push_back(std::move(pictures));
    seen.positions.push_back(std::move(positions));
  }
  return seen;
}

Novelty Fitted(const Seen& seen) {
  return Novelty::Fit(MatrixRows(seen.pictures), kShape, seen.begin, seen.positions);
}

double Of(const Novelty& novelty, const Eigen::VectorXd& picture, double x, double y) {
  const std::vector<float> pixels(picture.begin(), picture.end());
  Novelty::Workspace workspace(novelty);
  return novelty.Of(pixels, std::array{x, y}, workspace);
}

// One window changes by 40, as with a small object. Two positions have a new sum.
TEST(NoveltyTest, FlagsNewObjectsAndPositionsAndPassesDemonstrations) {
  const Novelty novelty = Fitted(Demonstrations(1, 40));
  EXPECT_LE(novelty.left_out(), 0.05);
  const Seen others = Demonstrations(2, 100);
  int beyond = 0;
  for (std::size_t d = 0; d < others.pictures.size(); ++d) {
    double most = 0.0;
    for (Eigen::Index i = 0; i < 12; ++i) {
      most = std::max(most, Of(novelty, others.pictures[d].row(i).transpose(),
                               others.positions[d](i, 0), others.positions[d](i, 1)));
    }
    beyond += most > 1.0 ? 1 : 0;
  }
  EXPECT_LE(beyond, 2);
  const Eigen::VectorXd middle = Eigen::VectorXd::Constant(kPixels, 100.0);
  EXPECT_LT(Of(novelty, middle, 0.5, 0.5), 0.5);
  Eigen::VectorXd object = middle;
  for (const int row : {0, 1, 2}) object.segment(5 * row, 3).array() += 40.0;
  EXPECT_GT(Of(novelty, object, 0.5, 0.5), 1.0);
  EXPECT_LT(Of(novelty, middle, 0.8, 0.2), 1.0);
  EXPECT_GT(Of(novelty, middle, 0.8, 0.8), 1.0);
}

// Compares the ratio of the statistics of two pictures, and of two positions: the limits cancel.
TEST(NoveltyTest, AgreesWithTheDefinition) {
  const Seen seen = Demonstrations(3, 20);
  const Novelty novelty = Fitted(seen);
  Matrix all(240, kPixels);
  Matrix places(240, 2);
  for (Eigen::Index d = 0; d < 20; ++d) {
    all.middleRows(12 * d, 12) = seen.pictures[static_cast<std::size_t>(d)];
    places.middleRows(12 * d, 12) = seen.positions[static_cast<std::size_t>(d)];
  }
  const Eigen::RowVectorXd mean = all.colwise().mean();
  const Eigen::RowVectorXd variance = (all.rowwise() - mean).cwiseAbs2().colwise().mean();
  const auto shift = [&](int pixel) {
    double along = 0.0;
    double down = 0.0;
    for (int other = 0; other < kPixels; ++other) {
      const double square = std::pow(mean[other] - mean[pixel], 2);
      if (std::abs(other - pixel) == 1 && other / 5 == pixel / 5) along = std::max(along, square);
      if (std::abs(other - pixel) == 5) down = std::max(down, square);
    }
    return along + down;
  };
  const auto defined = [&](const Eigen::RowVectorXd& x) {
    double most = 0.0;
    for (int row = 0; row < 2; ++row) {
      for (int column = 0; column < 3; ++column) {
        double squares = 0.0;
        double scale = 0.0;
        for (int i = 0; i < 9; ++i) {
          const int pixel = 5 * (row + i / 3) + column + i % 3;
          squares += std::pow(x[pixel] - mean[pixel], 2) / 9.0;
          scale += (variance[pixel] + shift(pixel)) / 9.0;
        }
        most = std::max(most, squares / (scale + 16.0));
      }
    }
    return most;
  };
  Eigen::RowVectorXd first = mean;
  first.segment(6, 2).array() += 90.0;
  Eigen::RowVectorXd second = mean;
  second[19] -= 120.0;
  const Eigen::RowVector2d middle = places.colwise().mean();
  const auto of = [&](const Eigen::RowVectorXd& x, const Eigen::RowVector2d& p) {
    return Of(novelty, x.transpose(), p[0], p[1]);
  };
  EXPECT_NEAR(of(first, middle) / of(second, middle), defined(first) / defined(second), 1e-4);
  const Matrix centred = places.rowwise() - middle;
  Eigen::Matrix2d covariance = centred.transpose() * centred / 240.0;
  covariance += 1e-3 * covariance.trace() / 2.0 * Eigen::Matrix2d::Identity();
  const auto squared = [&](const Eigen::RowVector2d& p) {
    return (p - middle) * covariance.inverse() * (p - middle).transpose();
  };
  const Eigen::RowVector2d near = middle + Eigen::RowVector2d(0.1, 0.1);
  const Eigen::RowVector2d far = middle + Eigen::RowVector2d(0.5, -0.2);
  EXPECT_NEAR(of(mean, near) / of(mean, far), squared(near)(0) / squared(far)(0), 1e-6);
}

// The edge of a table in front of a floor. The camera is at rest in all demonstrations.
TEST(NoveltyTest, AShiftOfTheCameraByAPixelPassesAndAnObjectDoesNot) {
  constexpr core::PictureShape kColours{10, 12, 3};
  const auto scene = [](int right, int down) {
    Eigen::VectorXd picture(360);
    for (int i = 0; i < 360; ++i) {
      const int row = i / 36 - down;
      const int column = i / 3 % 12 - right;
      picture[i] = row >= 5 && column >= 4 ? 190.0 - 30.0 * (i % 3) : 60.0;
    }
    return picture;
  };
  core::Random random(1);
  std::vector<Matrix> pictures(20, Matrix(8, 360));
  std::vector<Eigen::Index> begin{0};
  for (Matrix& rows : pictures) {
    for (auto row : rows.rowwise()) row = scene(0, 0).transpose();
    for (double& value : rows.reshaped()) value += 2.0 * random.Normal();
    begin.push_back(begin.back() + rows.rows());
  }
  const Novelty novelty = Novelty::Fit(MatrixRows(pictures), kColours, begin, {});
  Novelty::Workspace workspace(novelty);
  const auto of = [&](const Eigen::VectorXd& picture) {
    const std::vector<float> pixels(picture.begin(), picture.end());
    return novelty.Of(pixels, {}, workspace);
  };
  for (const auto& [right, down] : {std::pair(1, 0), {-1, 0}, {0, 1}, {0, -1}, {1, -1}}) {
    EXPECT_LT(of(scene(right, down)), 1.0) << right << ", " << down;
  }
  EXPECT_GT(of(scene(4, 0)), 1.0);
  Eigen::VectorXd object = scene(0, 0);
  for (const int row : {0, 1, 2}) object.segment(36 * row, 9).array() += 40.0;
  EXPECT_GT(of(object), 1.0);
}

TEST(NoveltyTest, AnInvalidPictureIsNovelAndNothingAllocates) {
  const Novelty novelty = Fitted(Demonstrations(1, 10));
  Novelty::Workspace workspace(novelty);
  std::vector<float> picture(kPixels, 100.0F);
  const std::array places{0.5, 0.5};
  {
    const test::NoAlloc no_alloc;
    static_cast<void>(novelty.Of(picture, places, workspace));
  }
  EXPECT_LT(novelty.Of(picture, places, workspace), 1.0);
  EXPECT_GT(novelty.Of(std::span(picture).first(19), places, workspace), 1.0);
  EXPECT_GT(novelty.Of(picture, std::span(places).first(1), workspace), 1.0);
  picture[3] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_GT(novelty.Of(picture, places, workspace), 1.0);
}

TEST(NoveltyTest, RefusesSizesThatDoNotMatch) {
  Seen seen = Demonstrations(1, 3);
  const auto message = [&] { return test::MessageOf([&] { static_cast<void>(Fitted(seen)); }); };
  EXPECT_EQ(message(), "nothing thrown");
  seen.positions[1].resize(11, 2);
  EXPECT_THAT(message(), HasSubstr("demonstration 1 has positions of another size"));
  seen.begin = {0, 12, 12, 36};
  EXPECT_THAT(message(), HasSubstr("demonstration 1 has "));
  seen.begin = {0, 36};
  EXPECT_THAT(message(), HasSubstr("needs two demonstrations, not 1"));
}

// Values of a file, in the order of the file.
struct Values {
  std::vector<double> mean = std::vector<double>(kPixels, 100.0);
  std::vector<double> variance = std::vector<double>(6, 116.0);
  std::vector<double> middle = {0.5, 0.5};
  Matrix whitening = Matrix::Identity(2, 2);
  std::array<double, 3> rest = {2.0, 3.0, 0.05};
};

TEST(NoveltyTest, HostileFilesAreRefusedByName) {
  const std::filesystem::path path = dfr::test::ProcessFolder() / "novelty_test.dfr";
  const auto message = [&](const std::function<void(Values&)>& change) {
    Values values;
    change(values);
    core::ArchiveWriter writer("test", 1);
    writer.Numbers(values.mean);
    writer.Numbers(values.variance);
    writer.Numbers(values.middle);
    writer.MatrixBlock(values.whitening);
    for (const double value : values.rest) writer.Number(value);
    writer.Save(path);
    core::ArchiveReader reader(path, "test", 1);
    return test::MessageOf([&] { static_cast<void>(Novelty::Load(reader, kShape)); });
  };
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(message([](Values&) {}), "nothing thrown");
  EXPECT_THAT(message([](Values& v) { v.mean.pop_back(); }), HasSubstr("there are 19 entries"));
  EXPECT_THAT(message([](Values& v) { v.variance.push_back(20.0); }), HasSubstr("7 variances"));
  EXPECT_THAT(message([](Values& v) { v.middle = {}; }), HasSubstr("0 positions"));
  EXPECT_THAT(message([](Values& v) { v.mean[3] = kNaN; }), HasSubstr("an entry is not finite"));
  EXPECT_THAT(message([](Values& v) { v.whitening(1, 0) = 1e10; }), HasSubstr("not within 1e+09"));
  EXPECT_THAT(message([](Values& v) { v.variance[2] = 0.0; }), HasSubstr("variance is 0"));
  EXPECT_THAT(message([](Values& v) { v.rest[0] = 0.0; }), HasSubstr("a limit must lie in (0, "));
  EXPECT_THAT(message([](Values& v) { v.rest[1] = kNaN; }), HasSubstr("a limit must lie in (0, "));
  EXPECT_THAT(message([](Values& v) { v.rest[2] = 1.5; }), HasSubstr("a share must lie in [0, 1]"));
  std::filesystem::remove(path);
}

}  // namespace
}  // namespace dfr::reduction
