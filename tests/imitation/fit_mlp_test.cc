#include "dfr/imitation/fit_mlp.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>

#include "dfr/core/numerics/linear_algebra.h"
#include "tests/support/all_close.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::imitation {
namespace {

using core::Matrix;
using testing::AllOf;
using testing::HasSubstr;

core::StateLayout Layout() {
  core::StateLayout layout;
  layout.Add("tip", 2);
  layout.Add("object", 1);
  return layout;
}

// States of very different sizes, and controls that are an affine function of them.
struct LinearCase {
  Matrix states;
  Matrix controls;
  Eigen::Matrix<double, 3, 2> slope;
  Eigen::RowVector2d offset{0.1, -0.3};

  explicit LinearCase(int rows, double noise = 0.0) : states(rows, 3), controls(rows, 2) {
    core::Random random(1);
    slope << 0.5, -20, 0.02, 0.1, -3, 7;
    for (Eigen::Index i = 0; i < rows; ++i) {
      states.row(i) << random.Normal(), 5 + 10 * random.Normal(), 0.1 * random.Normal();
    }
    slope.row(0) *= 0.1;
    controls = (states * slope).rowwise() + offset;
    for (Eigen::Index i = 0; i < controls.size(); ++i) {
      controls.data()[i] += noise * random.Normal();
    }
  }
};

Matrix Controls(const MlpPolicy& policy, const Matrix& states) {
  Matrix controls(states.rows(), policy.control_dim());
  for (Eigen::Index i = 0; i < states.rows(); ++i) {
    policy.Unlimited(core::Row(states, i), core::Row(controls, i));
  }
  return controls;
}

// Without a hidden layer the minimum is the solution of linear least squares, which all methods
// must reach. Adam's data are free of noise: the minima of all batches agree, and Adam can
// converge.
TEST(FitMlpTest, AllMethodsFindTheLeastSquaresSolution) {
  const LinearCase exact(300);
  FitReport report;
  const MlpPolicy adam = FitMlp(Layout(), exact.states, exact.controls,
                                {.hidden = {}, .epochs = 400, .learning_rate = 0.01}, &report);
  EXPECT_TRUE(test::AllClose(Controls(adam, exact.states), exact.controls, 1e-6));
  EXPECT_EQ(report.iterations, 400);
  EXPECT_EQ(report.rows, 300);

  const LinearCase noisy(300, 0.2);
  Eigen::MatrixXd design(300, 4);
  design << noisy.states, Eigen::VectorXd::Ones(300);
  const Eigen::MatrixXd solution = core::SolveLeastSquares(design, noisy.controls);
  for (const FitMethod method : {FitMethod::kLbfgs, FitMethod::kLevenbergMarquardt}) {
    const MlpPolicy policy =
        FitMlp(Layout(), noisy.states, noisy.controls, {.hidden = {}, .method = method}, &report);
    EXPECT_TRUE(report.converged) << report.message;
    // The loss is within 1e-9 of its minimum, and the error of the controls is therefore of the
    // order of the square root, 3e-5.
    EXPECT_TRUE(test::AllClose(Controls(policy, noisy.states), Matrix(design * solution), 1e-4));
  }
}

// With weight decay, the fit equals ridge regression on the standardised states.
TEST(FitMlpTest, WeightDecayGivesRidgeRegression) {
  const LinearCase data(300, 0.2);
  constexpr double kDecay = 0.5;
  const Matrix z = Whitening::FromData(data.states).Apply(data.states);
  const Eigen::RowVector2d mean = data.controls.colwise().mean();  // z has mean zero
  const Eigen::MatrixXd gram = z.transpose() * z / 300.0 + kDecay * Eigen::MatrixXd::Identity(3, 3);
  const Eigen::MatrixXd slope =
      core::SolveSymmetric(gram, z.transpose() * (data.controls.rowwise() - mean) / 300.0);
  for (const FitMethod method : {FitMethod::kLbfgs, FitMethod::kLevenbergMarquardt}) {
    const MlpPolicy policy = FitMlp(Layout(), data.states, data.controls,
                                    {.hidden = {}, .method = method, .weight_decay = kDecay});
    EXPECT_TRUE(
        test::AllClose(Controls(policy, data.states), Matrix((z * slope).rowwise() + mean), 1e-4));
  }
}

// A network can be recovered from its outputs, up to the symmetries of its units: the loss at the
// minimum is zero.
TEST(FitMlpTest, MinimisersFitTheOutputsOfASmallNetwork) {
  core::Random random(2);
  Matrix states(400, 3);
  for (Eigen::Index i = 0; i < states.size(); ++i) states.data()[i] = random.Normal();
  const Mlp teacher({3, 3, 2}, random);
  Mlp::Workspace workspace;
  const Matrix controls = teacher.Forward(states, workspace);
  for (const FitMethod method : {FitMethod::kLbfgs, FitMethod::kLevenbergMarquardt}) {
    FitReport report;
    FitMlp(Layout(), states, controls, {.hidden = {8}, .method = method, .max_iterations = 2000},
           &report);
    EXPECT_LT(report.final_loss, 1e-5 * report.initial_loss) << report.message;
    EXPECT_GT(report.iterations, 1);
  }
}

TEST(FitMlpTest, TheWeakLearnerImprovesAndDependsOnItsSeedOnly) {
  const LinearCase data(900, 0.1);
  FitReport report;
  FitMlpOptions options = {.hidden = {8}, .seed = 3};
  const MlpPolicy first = FitMlp(Layout(), data.states, data.controls, options, &report);
  EXPECT_LT(report.final_loss, 0.5 * report.initial_loss);
  EXPECT_FALSE(report.converged);
  const MlpPolicy second = FitMlp(Layout(), data.states, data.controls, options);
  EXPECT_EQ(first.mlp().parameters(), second.mlp().parameters());
  options.seed = 4;
  const MlpPolicy third = FitMlp(Layout(), data.states, data.controls, options);
  EXPECT_NE(first.mlp().parameters(), third.mlp().parameters());
}

TEST(FitMlpTest, RowsWithZeroControlsAreLeftOutUnlessWanted) {
  LinearCase data(300);
  Matrix padded_states(330, 3), padded_controls = Matrix::Zero(330, 2);
  padded_states << data.states, Matrix::Constant(30, 3, 99.0);
  padded_controls.topRows(300) = data.controls;
  FitReport report;
  const FitMlpOptions options = {.hidden = {4}};
  const MlpPolicy padded = FitMlp(Layout(), padded_states, padded_controls, options, &report);
  EXPECT_EQ(report.rows, 300);
  EXPECT_EQ(report.skipped_rows, 30);
  const MlpPolicy plain = FitMlp(Layout(), data.states, data.controls, options);
  EXPECT_EQ(padded.mlp().parameters(), plain.mlp().parameters());
  EXPECT_EQ(padded.whitening().mean(), plain.whitening().mean());
  FitMlp(Layout(), padded_states, padded_controls, {.hidden = {4}, .skip_zero_controls = false},
         &report);
  EXPECT_EQ(report.rows, 330);
}

TEST(FitMlpTest, DemonstrationsAreTheirStateControlPairs) {
  const LinearCase data(10);
  DemonstrationSet set;
  set.layout = Layout();
  set.control_dim = 2;
  set.trajectories.resize(2);
  set.trajectories[0].states = data.states.topRows(5);  // four controls and the last state
  set.trajectories[0].controls = data.controls.topRows(4);
  set.trajectories[1].states = data.states.bottomRows(4);
  set.trajectories[1].controls = data.controls.middleRows(6, 3);
  Matrix states(7, 3), controls(7, 2);
  states << data.states.topRows(4), data.states.middleRows(6, 3);
  controls << data.controls.topRows(4), data.controls.middleRows(6, 3);
  const FitMlpOptions options = {.hidden = {4}, .features = "object,tip[0:1]"};
  const MlpPolicy from_set = FitMlp(set, options);
  const MlpPolicy from_rows = FitMlp(Layout(), states, controls, options);
  EXPECT_EQ(from_set.mlp().parameters(), from_rows.mlp().parameters());
  EXPECT_EQ(from_set.selection().spec(), "object,tip[0:1]");
  EXPECT_EQ(from_set.layout(), Layout());

  set.trajectories[1].states(2, 0) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(test::MessageOf<std::invalid_argument>([&] { FitMlp(set, options); }),
              HasSubstr("states of demonstration 1: row 2, column 0 is nan"));
  set.trajectories[1].controls.resize(3, 1);
  EXPECT_THAT(test::MessageOf<std::invalid_argument>([&] { FitMlp(set, options); }),
              HasSubstr("demonstration 1 has states of 4 x 3 and controls of 3 x 1"));
}

TEST(FitMlpTest, ErrorsNameTheRowTheShapeOrTheOption) {
  const LinearCase good(20);
  const auto message = [&](auto change) {
    LinearCase data = good;
    FitMlpOptions options = {.hidden = {4}};
    change(data, options);
    return test::MessageOf<std::invalid_argument>(
        [&] { FitMlp(Layout(), data.states, data.controls, options); });
  };
  EXPECT_THAT(message([](auto& d, auto&) { d.states(7, 2) = std::nan(""); }),
              HasSubstr("states: row 7, column 2 is nan"));
  EXPECT_THAT(message([](auto& d, auto&) { d.controls(9, 0) = INFINITY; }),
              HasSubstr("controls: row 9, column 0 is inf"));
  EXPECT_THAT(message([](auto& d, auto&) { d.controls.conservativeResize(19, 2); }),
              HasSubstr("20 states and 19 controls"));
  EXPECT_THAT(message([](auto& d, auto&) { d.states.conservativeResize(20, 2); }),
              HasSubstr("states have 2 columns, but their layout has 3"));
  EXPECT_THAT(message([](auto& d, auto&) {
                d.states.resize(0, 3);
                d.controls.resize(0, 2);
              }),
              HasSubstr("nothing to fit"));
  EXPECT_THAT(message([](auto& d, auto&) { d.controls.setZero(); }),
              HasSubstr("all 20 controls are zero"));
  EXPECT_THAT(message([](auto&, auto& o) { o.epochs = 0; }), HasSubstr("epochs"));
  EXPECT_THAT(message([](auto&, auto& o) { o.learning_rate = -1; }), HasSubstr("learning rate"));
  EXPECT_THAT(message([](auto&, auto& o) { o.weight_decay = -1; }), HasSubstr("weight decay"));
  EXPECT_THAT(message([](auto&, auto& o) { o.features = "gripper"; }), HasSubstr("'gripper'"));
  EXPECT_THAT(message([](auto&, auto& o) { o.hidden = {-1}; }), HasSubstr("layer 1"));
  EXPECT_THAT(message([](auto&, auto& o) { o.learning_rate = 1e300; }),
              AllOf(HasSubstr("Adam diverges"), HasSubstr("1e+300")));
  EXPECT_THAT(message([](auto& d, auto& o) {
                d.states = Matrix::Random(20000, 3);
                d.controls = Matrix::Random(20000, 2);
                o.hidden = {128, 128};
                o.method = FitMethod::kLevenbergMarquardt;
              }),
              AllOf(HasSubstr("GB"), HasSubstr("L-BFGS")));
  // Weight decay adds a residual for each of the 384 + 16384 + 256 weights.
  EXPECT_THAT(message([](auto&, auto& o) {
                o.hidden = {128, 128};
                o.method = FitMethod::kLevenbergMarquardt;
                o.weight_decay = 1e-4;
              }),
              AllOf(HasSubstr("2.35"), HasSubstr("17064 residuals"), HasSubstr("L-BFGS")));
}

}  // namespace
}  // namespace dfr::imitation
