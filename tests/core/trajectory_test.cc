#include "dfr/core/trajectory.h"

#include <gtest/gtest.h>

#include <set>

namespace dfr::core {
namespace {

// Six demonstrations of 4 steps; demonstration 2 rests at step 1, demonstration 5 has one step.
TEST(SelectControlsTest, AWindowCoversDemonstrationsThatOneStepDoesNot) {
  std::vector<Matrix> controls(6, Matrix::Ones(4, 2));
  controls[2].row(1).setZero();
  controls[5] = Matrix::Ones(1, 2);
  std::vector<const Matrix*> pointers;
  for (const Matrix& matrix : controls) pointers.push_back(&matrix);
  const ControlSelection two = SelectControls(pointers, 2);
  EXPECT_EQ(two.begin, (std::vector{0, 2, 4, 6, 8}));
  std::set<std::size_t> seen;
  for (std::size_t row = 0; row < two.rows.size(); ++row) {
    const auto& [d, t] = two.rows[row];
    seen.insert(d);
    EXPECT_EQ(t, static_cast<Eigen::Index>(row / 2));
    EXPECT_LT(t, controls[d].rows());
    EXPECT_FALSE(d == 2 && t == 1) << "the control is zero";
  }
  EXPECT_EQ(seen, (std::set<std::size_t>{0, 1, 2, 3, 4}));
  const ControlSelection all = SelectControls(pointers, 99);
  EXPECT_EQ(all.begin, (std::vector{0, 6, 10, 15, 20}));
  EXPECT_EQ(std::set(all.rows.begin(), all.rows.end()).size(), 20U);
  EXPECT_TRUE(SelectControls({}, 2).rows.empty());
}

}  // namespace
}  // namespace dfr::core
