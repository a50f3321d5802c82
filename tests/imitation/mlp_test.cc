#include "dfr/imitation/mlp.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

#include "tests/support/all_close.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"
#include "tests/support/random_matrix.h"
#include "tests/support/temp_folder.h"

namespace dfr::imitation {
namespace {

using core::Matrix;
using testing::HasSubstr;

Matrix RandomMatrix(Eigen::Index rows, Eigen::Index cols, std::uint64_t seed) {
  core::Random random(seed);
  return test::RandomMatrix(random, rows, cols);
}

Eigen::VectorXd RandomVector(Eigen::Index size, std::uint64_t seed) {
  return RandomMatrix(size, 1, seed).col(0);
}

// Returns a network with random biases, which a new network does not have.
Mlp RandomMlp(std::vector<int> sizes, std::uint64_t seed) {
  Mlp mlp(std::move(sizes));
  mlp.SetParameters(0.5 * RandomVector(mlp.num_parameters(), seed));
  return mlp;
}

// Computes the documented formula with Eigen, in the documented order of parameters.
Matrix Definition(const Mlp& mlp, const Matrix& inputs) {
  Matrix h = inputs;
  Eigen::Index offset = 0;
  const int layers = static_cast<int>(mlp.sizes().size()) - 1;
  for (int l = 0; l < layers; ++l) {
    const int in = mlp.sizes()[static_cast<std::size_t>(l)];
    const int out = mlp.sizes()[static_cast<std::size_t>(l) + 1];
    const Eigen::Map<const Matrix> w(mlp.parameters().data() + offset, in, out);
    const auto b = mlp.parameters().segment(offset + Eigen::Index{in} * out, out);
    h = ((h * w).rowwise() + b.transpose()).eval();
    if (l + 1 < layers) h = h.array().tanh().matrix().eval();
    offset += Eigen::Index{in} * out + out;
  }
  return h;
}

const std::vector<std::vector<int>>& Shapes() {
  static const std::vector<std::vector<int>> shapes = {
      {3, 2}, {12, 8, 7}, {21, 64, 64, 7}, {5, 9, 1, 3, 2}, {1, 1}};
  return shapes;
}

double Loss(const Mlp& mlp, const Matrix& inputs, const Matrix& weights) {
  return Definition(mlp, inputs).cwiseProduct(weights).sum();
}

TEST(MlpTest, ForwardIsTheDocumentedFormula) {
  for (const auto& shape : Shapes()) {
    const Mlp mlp = RandomMlp(shape, 1);
    const Matrix x = RandomMatrix(205, mlp.input_dim(), 2);
    Mlp::Workspace workspace;
    // The sums have up to 65 terms of size 1: 1e-13 is well above their rounding.
    EXPECT_TRUE(test::AllClose(mlp.Forward(x, workspace), Definition(mlp, x), 1e-13));
  }
}

TEST(MlpTest, OneSampleGivesTheSameBitsAsInABatch) {
  for (const auto& shape : Shapes()) {
    const Mlp mlp = RandomMlp(shape, 3);
    const Matrix x = RandomMatrix(101, mlp.input_dim(), 4);
    Mlp::Workspace workspace;
    const Matrix batch = mlp.Forward(x, workspace);
    Eigen::VectorXd y(mlp.output_dim());
    for (Eigen::Index i = 0; i < x.rows(); ++i) {
      mlp.Forward(core::Row(x, i), core::AsSpan(y));
      ASSERT_EQ(y.transpose(), batch.row(i)) << "sample " << i;
    }
  }
}

TEST(MlpTest, BackwardIsTheGradientInTheParameters) {
  constexpr double kStep = 1e-5;
  for (const auto& shape : Shapes()) {
    Mlp mlp = RandomMlp(shape, 5);
    const Matrix x = RandomMatrix(7, mlp.input_dim(), 6);
    const Matrix weights = RandomMatrix(7, mlp.output_dim(), 7);
    Mlp::Workspace workspace;
    Eigen::VectorXd gradient;
    mlp.Forward(x, workspace);
    mlp.Backward(x, weights, workspace, gradient);
    const Eigen::VectorXd theta = mlp.parameters();
    // In a large network, every 37th parameter is tested, which covers each layer's weights and
    // biases.
    const Eigen::Index stride = mlp.num_parameters() > 500 ? 37 : 1;
    for (Eigen::Index i = 0; i < theta.size(); i += stride) {
      Eigen::VectorXd moved = theta;
      moved[i] = theta[i] + kStep;
      mlp.SetParameters(moved);
      const double above = Loss(mlp, x, weights);
      moved[i] = theta[i] - kStep;
      mlp.SetParameters(moved);
      const double below = Loss(mlp, x, weights);
      // The tolerance covers both errors of a central difference: the square of the step times a
      // third derivative of about 10, and the rounding error over the step.
      ASSERT_NEAR(gradient[i], (above - below) / (2.0 * kStep), 2e-8) << "parameter " << i;
    }
  }
}

TEST(MlpTest, TangentIsTheDerivativeAlongADirection) {
  constexpr double kStep = 1e-6;
  for (const auto& shape : Shapes()) {
    Mlp mlp = RandomMlp(shape, 11);
    const Matrix x = RandomMatrix(100, mlp.input_dim(), 12);
    const Eigen::VectorXd direction = RandomVector(mlp.num_parameters(), 13).normalized();
    Mlp::Workspace workspace;
    mlp.Forward(x, workspace);
    const Matrix tangent = mlp.Tangent(x, direction, workspace);
    const Eigen::VectorXd theta = mlp.parameters();
    mlp.SetParameters(theta + kStep * direction);
    const Matrix above = Definition(mlp, x);
    mlp.SetParameters(theta - kStep * direction);
    const Matrix below = Definition(mlp, x);
    EXPECT_TRUE(test::AllClose(tangent, (above - below) / (2.0 * kStep), 1e-8));
  }
}

TEST(MlpTest, JacobianRowsAreGradientsOfSingleOutputs) {
  for (const auto& shape : Shapes()) {
    const Mlp mlp = RandomMlp(shape, 18);
    const Matrix x = RandomMatrix(4, mlp.input_dim(), 19);
    Mlp::Workspace workspace;
    mlp.Forward(x, workspace);
    Matrix jacobian(4 * mlp.output_dim(), mlp.num_parameters());
    mlp.Jacobian(x, workspace, jacobian);
    Eigen::VectorXd gradient;
    for (int i = 0; i < 4; ++i) {
      for (int o = 0; o < mlp.output_dim(); ++o) {
        Matrix one = Matrix::Zero(4, mlp.output_dim());
        one(i, o) = 1.0;
        mlp.Backward(x, one, workspace, gradient);
        EXPECT_TRUE(test::AllClose(jacobian.row(i * mlp.output_dim() + o).transpose(), gradient,
                                   1e-13, 1e-13));
      }
    }
  }
}

TEST(MlpTest, RowsOfALargerMatrixNeedNoCopy) {
  const Mlp mlp = RandomMlp({6, 10, 2}, 20);
  const Matrix wide = RandomMatrix(120, 9, 21);
  const Matrix narrow = wide.leftCols(6);
  const Matrix weights = RandomMatrix(120, 2, 22);
  Mlp::Workspace workspace;
  Eigen::VectorXd expected, actual;
  const Matrix outputs = mlp.Forward(narrow, workspace);
  mlp.Backward(narrow, weights, workspace, expected);
  EXPECT_EQ(mlp.Forward(wide.leftCols(6), workspace), outputs);
  mlp.Backward(wide.leftCols(6), weights, workspace, actual);
  EXPECT_EQ(actual, expected);
}

TEST(MlpTest, FreshNetworksDependOnTheirSeedOnlyAndHaveTheDocumentedSpread) {
  core::Random first(23), second(23), third(24);
  const Mlp a({100, 80, 60}, first, 0.1), b({100, 80, 60}, second, 0.1), c({100, 80, 60}, third);
  EXPECT_EQ(a.parameters(), b.parameters());
  EXPECT_NE(a.parameters(), c.parameters());
  EXPECT_EQ(a.parameters().segment(8000, 80).norm(), 0.0);
  EXPECT_EQ(a.parameters().tail(60).norm(), 0.0);
  // The relative standard error of a standard deviation from n draws is 1/sqrt(2n). The limit is
  // four standard errors.
  const double hidden = a.parameters().head(8000).norm() / std::sqrt(8000.0);
  EXPECT_NEAR(hidden, 0.1, 4.0 * 0.1 / std::sqrt(16000.0));
  const double output = a.parameters().segment(8080, 4800).norm() / std::sqrt(4800.0);
  EXPECT_NEAR(output, 0.1 / std::sqrt(80.0), 4.0 * 0.1 / std::sqrt(80.0 * 9600.0));
}

TEST(MlpTest, LoopsOverBatchesDoNotAllocate) {
  const Mlp mlp = RandomMlp({12, 64, 64, 7}, 25);
  const Matrix x = RandomMatrix(200, 12, 26), small = RandomMatrix(31, 12, 27);
  const Matrix w = RandomMatrix(200, 7, 28), small_w = RandomMatrix(31, 7, 29);
  const Eigen::VectorXd direction = RandomVector(mlp.num_parameters(), 30);
  Mlp::Workspace workspace;
  Eigen::VectorXd gradient, y(7);
  const auto all_calls = [&](const Matrix& inputs, const Matrix& weights) {
    mlp.Forward(inputs, workspace);
    mlp.Backward(inputs, weights, workspace, gradient);
    mlp.Tangent(inputs, direction, workspace);
  };
  all_calls(x, w);
  const test::NoAlloc guard;
  all_calls(small, small_w);
  all_calls(x, w);
  mlp.Forward(core::Row(x, 0), core::AsSpan(y));
}

// A short list of sizes can request any number of weights: here 5 GB and 800 GB.
TEST(MlpTest, AFileWithAnotherNumberOfParametersIsRefusedByName) {
  const test::TempFolder folder;
  constexpr const char* kLarge = "weights of 8 bytes, too many for a file of";
  for (const auto& [sizes, message] : {std::pair(std::vector{4, 5, 2}, "37 parameters, not 36"),
                                       {std::vector(600, Mlp::kMaxWidth), kLarge},
                                       {std::vector(100'000, Mlp::kMaxWidth), kLarge}}) {
    core::ArchiveWriter writer("mlp", 1);
    writer.Integers(sizes);
    writer.Numbers(std::vector<double>(36, 0.0));
    writer.Save(folder / "a.dfr");
    core::ArchiveReader reader(folder / "a.dfr", "mlp", 1);
    EXPECT_THAT(test::MessageOf<std::runtime_error>([&] { Mlp::Load(reader); }),
                testing::AllOf(HasSubstr("a.dfr"), HasSubstr(message)));
  }
}

TEST(MlpTest, ErrorsNameTheShapesThatDoNotFit) {
  const auto message = [](const auto& call) {
    return test::MessageOf<std::invalid_argument>(call);
  };
  EXPECT_THAT(message([] { Mlp({3}); }),
              HasSubstr("at least two sizes, inputs and outputs, not 1"));
  EXPECT_THAT(message([] { Mlp({3, 0, 2}); }), HasSubstr("layer 1"));
  EXPECT_THAT(message([] { Mlp({3, 2000, 2}); }), HasSubstr("2000 units"));
  Mlp mlp({3, 4, 2});
  Mlp::Workspace workspace;
  EXPECT_THAT(message([&] { mlp.Forward(Matrix::Zero(5, 4), workspace); }),
              HasSubstr("takes 3 inputs, not 4"));
  Eigen::VectorXd gradient;
  const auto backward = [&](int outputs) {
    return message(
        [&] { mlp.Backward(Matrix::Zero(5, 3), Matrix::Zero(5, outputs), workspace, gradient); });
  };
  EXPECT_THAT(backward(2), HasSubstr("last Forward()"));
  mlp.Forward(Matrix::Zero(5, 3), workspace);
  EXPECT_THAT(backward(3), HasSubstr("is 5 x 3; the outputs are 5 x 2"));
  Eigen::VectorXd parameters = mlp.parameters();
  parameters[6] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(message([&] { mlp.SetParameters(parameters); }), HasSubstr("parameter 6 is nan"));
}

}  // namespace
}  // namespace dfr::imitation
