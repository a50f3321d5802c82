#include "dfr/reduction/reduction.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "dfr/core/random.h"
#include "tests/support/all_close.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"
#include "tests/support/temp_folder.h"

namespace dfr::reduction {
namespace {

using core::Matrix;
using testing::HasSubstr;

constexpr int kInputs = 1300;  // Several chunks and a remainder.
constexpr int kComponents = 7;

Reduction Random(std::uint64_t seed) {
  core::Random random(seed);
  Eigen::VectorXd mean(kInputs);
  Eigen::VectorXd scale(kInputs);
  Matrix projection(kComponents, kInputs);
  for (double& value : mean) value = random.Uniform(0.0, 255.0);
  for (double& value : scale) value = random.Uniform(1.0, 60.0);
  for (double& value : projection.reshaped()) value = random.Normal() / std::sqrt(kInputs);
  scale[5] = 0.0;
  return {mean, scale, projection};
}

Reduction Read(const std::filesystem::path& path) {
  core::ArchiveReader archive(path, "reduction", 1);
  Reduction reduction = Reduction::Load(archive);
  archive.End();
  return reduction;
}

TEST(ReductionTest, AgreesWithTheDefinitionForEachTypeOfInputAndAllocatesNothing) {
  const Reduction reduction = Random(1);
  core::Random random(2);
  std::vector<float> floats(kInputs);
  for (float& pixel : floats) pixel = static_cast<float>(random.Below(256));
  const std::vector<double> x(floats.begin(), floats.end());
  Eigen::VectorXd a = core::AsVector(x) - reduction.mean();
  for (int i = 0; i < kInputs; ++i) {
    a[i] = reduction.scale()[i] > 0.0 ? a[i] / reduction.scale()[i] : 0.0;
  }
  const Eigen::VectorXd expected = reduction.projection() * a;
  Eigen::VectorXd z(kComponents), of_floats(kComponents);
  {
    const test::NoAlloc guard;
    reduction.Apply(x, core::AsSpan(z));
    reduction.Apply(floats, core::AsSpan(of_floats));
  }
  EXPECT_TRUE(test::AllClose(z, expected, 1e-5));  // The weights are in float.
  EXPECT_EQ(z, of_floats);
}

TEST(ReductionTest, FarFromZeroKeepsSmallDifferences) {
  const Reduction reduction(Eigen::VectorXd::Constant(2, 1e6), Eigen::VectorXd::Constant(2, 1e-3),
                            Matrix::Identity(2, 2));
  Eigen::VectorXd z(2);
  reduction.Apply(std::vector<double>{1e6 + 1e-3, 1e6 - 2e-3}, core::AsSpan(z));
  EXPECT_TRUE(test::AllClose(z, Eigen::Vector2d(1.0, -2.0), 1e-6));
}

TEST(ReductionTest, BadStatesGiveNoFiniteValue) {
  const Reduction reduction = Random(5);
  Eigen::VectorXd z(kComponents);
  const auto none_finite = [&](std::span<const double> x) {
    z.setZero();
    reduction.Apply(x, core::AsSpan(z));
    return !z.array().isFinite().any();
  };
  std::vector<double> x(kInputs, 1.0);
  EXPECT_FALSE(none_finite(x));
  EXPECT_TRUE(none_finite(std::span(x).first(kInputs - 1)));
  for (const std::size_t entry : {0U, 5U, 900U}) {
    for (const double bad : {std::numeric_limits<double>::quiet_NaN(),
                             std::numeric_limits<double>::infinity(), 1e300}) {
      x[entry] = bad;
      EXPECT_TRUE(none_finite(x)) << entry << ' ' << bad;
      x[entry] = 1.0;
    }
  }
}

TEST(ReductionTest, ProjectsOnPrincipalComponents) {
  core::Random random(8);
  Matrix rows(60, 20);
  for (double& value : rows.reshaped()) value = random.Normal();
  const PrincipalComponents fit = FitPrincipalComponents(MatrixRows({&rows, 1}), {.components = 6});
  const Reduction reduction = Reduction::Principal(fit, 4);
  Matrix z(rows.rows(), 4);
  for (Eigen::Index i = 0; i < rows.rows(); ++i) {
    reduction.Apply(core::Row(std::as_const(rows), i), core::Row(z, i));
  }
  EXPECT_TRUE(test::AllClose(z, Matrix(fit.scores.leftCols(4)), 1e-5));
  EXPECT_THAT(test::MessageOf([&] { (void)Reduction::Principal(fit, 7); }),
              HasSubstr("there are 6 principal components, not 7"));
}

TEST(ReductionTest, RefusesInvalidParts) {
  const Eigen::VectorXd three = Eigen::VectorXd::Ones(3);
  const Matrix projection = Matrix::Ones(2, 3);
  const auto message = [](const Eigen::VectorXd& mean, const Eigen::VectorXd& scale,
                          const Matrix& p) {
    return test::MessageOf([&] { (void)Reduction(mean, scale, p); });
  };
  EXPECT_THAT(message(three, Eigen::VectorXd::Ones(2), projection),
              HasSubstr("mean, scale and projection have 3, 2 and 3 entries"));
  EXPECT_THAT(message(three, three, Matrix(0, 3)), HasSubstr("1 to 256 components, not 0"));
  EXPECT_THAT(message(three, three, Matrix::Ones(300, 3)), HasSubstr("not 300"));
  EXPECT_THAT(message({}, {}, Matrix(1, 0)), HasSubstr("takes 1 to"));
  EXPECT_THAT(message(three, -three, projection), HasSubstr("a scale is negative: -1"));
  EXPECT_THAT(message(three, three * 1e-300, projection), HasSubstr("a scale is too small"));
  EXPECT_THAT(message(three / 0.0, three, projection), HasSubstr("must be finite"));
  EXPECT_THAT(message(three, three, std::nan("") * projection), HasSubstr("must be finite"));
}

TEST(ReductionTest, AFileKeepsAllBits) {
  const auto path = dfr::test::ProcessFolder() / "reduction.dfr";
  const Reduction reduction = Random(9);
  core::ArchiveWriter archive("reduction", 1);
  reduction.Save(archive);
  archive.Save(path);
  const Reduction loaded = Read(path);
  std::filesystem::remove(path);
  EXPECT_EQ(loaded.mean(), reduction.mean());
  EXPECT_EQ(loaded.scale(), reduction.scale());
  EXPECT_EQ(loaded.projection(), reduction.projection());
}

// RefusesInvalidParts tests all parts. The reader of archives has its own tests.
TEST(ReductionTest, AFileWithInvalidPartsIsRefusedByName) {
  const auto path = dfr::test::ProcessFolder() / "hostile_reduction.dfr";
  const Eigen::VectorXd three = Eigen::VectorXd::Ones(3);
  const auto message = [&](const Eigen::VectorXd& scale, const Matrix& projection, bool more) {
    core::ArchiveWriter archive("reduction", 1);
    archive.Numbers(core::AsSpan(three));
    archive.Numbers(core::AsSpan(scale));
    archive.MatrixBlock(projection);
    if (more) archive.Integer(1);
    archive.Save(path);
    return test::MessageOf<std::runtime_error>([&] { (void)Read(path); });
  };
  EXPECT_THAT(message(-three, Matrix::Ones(1, 3), false),
              HasSubstr("hostile_reduction.dfr: holds no reduction: a scale is"));
  EXPECT_THAT(message({}, Matrix(0, 0), false), HasSubstr("holds no reduction"));
  EXPECT_THAT(message(three, Matrix::Ones(1, 3), true), HasSubstr("bytes after its last value"));
  std::filesystem::remove(path);
}

}  // namespace
}  // namespace dfr::reduction
