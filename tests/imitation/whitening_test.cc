#include "dfr/imitation/whitening.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>

#include "dfr/core/random.h"
#include "tests/support/all_close.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"
#include "tests/support/temp_folder.h"

namespace dfr::imitation {
namespace {

using core::Matrix;
using testing::HasSubstr;

// Features of very different sizes and offsets.
Matrix Samples() {
  core::Random random(1);
  Matrix samples(500, 3);
  for (Eigen::Index i = 0; i < samples.rows(); ++i) {
    samples.row(i) << random.Normal(), 0.7 + 1e-4 * random.Normal(), -300.0 + 50 * random.Normal();
  }
  return samples;
}

TEST(WhiteningTest, WhitenedDataHaveMeanZeroAndDeviationOne) {
  const Matrix z = Whitening::FromData(Samples()).Apply(Samples());
  // The second feature's rounding error, 1e-16 of 0.7, is divided by the feature's scale of 1e-4.
  EXPECT_TRUE(test::AllClose(z.colwise().mean(), Eigen::RowVector3d::Zero(), 1e-11));
  EXPECT_TRUE(test::AllClose(z.array().square().matrix().colwise().mean(),
                             Eigen::RowVector3d::Ones(), 1e-11));
}

TEST(WhiteningTest, ConstantFeaturesAreOnlyShifted) {
  Matrix samples(3, 2);
  samples << 0.1, 5, 0.1, 6, 0.1, 7;  // the mean of three 0.1 is not exactly 0.1
  const Whitening whitening = Whitening::FromData(samples);
  EXPECT_EQ(whitening.scale()[0], 1.0);
  EXPECT_TRUE(test::AllClose(whitening.Apply(samples).col(0), Eigen::Vector3d::Zero(), 1e-16));
}

TEST(WhiteningTest, OneSampleIsWhitenedInPlaceWithoutAllocating) {
  const Whitening whitening(Eigen::Vector2d(1, 2), Eigen::Vector2d(2, 4));
  double x[] = {3, -6};
  const test::NoAlloc guard;
  whitening.Apply(x, x);
  EXPECT_EQ(x[0], 1.0);
  EXPECT_EQ(x[1], -2.0);
}

TEST(WhiteningTest, ErrorsNameTheEntry) {
  const auto message = [](const auto& call) {
    return test::MessageOf<std::invalid_argument>(call);
  };
  const Eigen::Vector2d mean(1, 2);
  Matrix samples = Samples();
  samples(17, 2) = std::numeric_limits<double>::infinity();
  EXPECT_THAT(message([&] { Whitening::FromData(samples); }), HasSubstr("row 17, column 2 is inf"));
  EXPECT_THAT(message([] { Whitening::FromData(Matrix(0, 3)); }), HasSubstr("not 0 x 3"));
  EXPECT_THAT(message([&] { Whitening(mean, Eigen::Vector2d(1, 0)); }),
              HasSubstr("feature 1 is 0"));
  EXPECT_THAT(message([&] { Whitening(mean, Eigen::Vector3d(1, 1, 1)); }), HasSubstr("2 and 3"));
  EXPECT_THAT(message([] { (void)Whitening::Identity(2).Apply(Matrix::Zero(1, 3)); }),
              HasSubstr("2 features, but the samples have 3"));
}

}  // namespace
}  // namespace dfr::imitation
