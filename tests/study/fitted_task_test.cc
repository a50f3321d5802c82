#include "dfr/study/fitted_task.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "apps/study/task.h"
#include "dfr/core/matrix.h"
#include "tests/support/no_alloc.h"

namespace dfr::study {
namespace {

// Controls of the pick task are metres and a gripper command of +-1. A guard passes this command
// unchanged.
const LearnedModel& Pick() {
  static const LearnedModel model = MakeTask("pick").learn(20, 5);
  return model;
}

class FarAside final : public core::Policy {
 public:
  [[nodiscard]] int state_dim() const noexcept override {
    return Pick().demonstrations().layout.state_dim();
  }
  [[nodiscard]] int control_dim() const noexcept override { return 4; }
  void Control(int /*t*/, std::span<const double> /*x*/,
               std::span<double> u) const noexcept override {
    std::ranges::copy(std::array{0.5, -0.5, 0.0, -1.0}, u.begin());
  }
};

TEST(FittedTaskTest, SteeredEntriesKeepTheirLimitsAndOthersAreThePolicys) {
  const FittedTask& fit = Pick().fit();
  ASSERT_FALSE(fit.guard()->actions().entries()[3].steered);
  const std::vector<double>& limit = fit.guard()->settings().action_limit;
  const FarAside policy;
  const core::Matrix& states = Pick().demonstrations().trajectories[0].states;
  for (const auto kind : {safety::Method::Kind::kController, safety::Method::Kind::kGuard}) {
    const auto controller = fit.MakeController({.name = "it", .kind = kind}, policy);
    controller->Reset(1);
    std::array<double, 4> u{};
    int controls = 0;
    for (Eigen::Index t = 0; t < states.rows(); ++t) {
      control::Step step;
      {
        const test::NoAlloc none;
        step = controller->Next(core::Row(states, t), u);
      }
      if (step.mode == control::Mode::kHalt) break;
      ++controls;
      for (std::size_t i = 0; i < 3; ++i) EXPECT_LE(std::abs(u[i]), limit[i]);
      EXPECT_EQ(u[3], -1.0);
    }
    EXPECT_GT(controls, 0);
  }
}

TEST(FittedTaskTest, ADirectionIsEnlargedToTheSizeOfDemonstratedControls) {
  std::array<double, 4> u = {1.0, 0.0, 0.0, 0.0};
  Pick().fit().Enlarge(u);
  const double largest = Pick().fit().guard()->actions().entries()[0].largest;
  EXPECT_GT(u[0], 0.5 * largest);
  EXPECT_LT(u[0], 5.0 * largest);
  // One unit for all entries: the norm of the largest control.
  const LearnedModel corridor = MakeTask("planar-corridor").learn(10, 5);
  double norm = 0.0;
  for (const core::Trajectory& d : corridor.demonstrations().trajectories) {
    norm = std::max(norm, d.controls.rowwise().norm().maxCoeff());
  }
  std::array<double, 2> v = {0.0, 1.0};
  corridor.fit().Enlarge(v);
  EXPECT_NEAR(v[1], norm, 1e-9);
}

TEST(FittedTaskTest, AGuardsFitIsNotSavedAsAModel) {
  EXPECT_THROW(Pick().Save("nowhere"), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::study
