#include "dfr/control/guided/state_observer.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <limits>
#include <memory>
#include <vector>

#include "dfr/control/response/response_estimate.h"
#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "tests/control/guided/linear_demonstrations.h"
#include "tests/support/all_close.h"
#include "tests/support/no_alloc.h"

namespace dfr::control {
namespace {

constexpr double kForgetting = 0.93;

class StateObserverTest : public testing::Test {
 protected:
  // Performs a controller's update: control `v`, predicted by `fit`, changed the observed state
  // `before` by `dz`.
  void Learn(const LocalFit* fit, const Eigen::VectorXd& before, const Eigen::VectorXd& v,
             const Eigen::VectorXd& dz) {
    const test::NoAlloc guard;
    observer_.Update(fit, core::AsSpan(v), core::AsSpan(dz));
    estimate_.Update(fit_, core::AsSpan(before), observer_.acting(), core::AsSpan(dz), 0.0, 1.0);
  }

  core::Random random_{13};
  core::Matrix truth_ = (core::Matrix(2, 2) << 0.2, 0.1, -0.1, 0.3).finished();
  std::shared_ptr<const TransitionStore> prior_ =
      test::Store(test::Linear(truth_, 30, 10, random_));
  ResponseEstimate estimate_{prior_};
  LocalFit fit_ = estimate_.MakeFit();
  StateObserver observer_{2, 2, kForgetting};
};

// A plant with a lag: each control takes effect some controls later.
class LagTest : public StateObserverTest, public testing::WithParamInterface<int> {
 protected:
  // Applies `count` controls with observation noise `noise`.
  void Drive(int count, int lag, double noise) {
    for (int i = 0; i < count; ++i) {
      estimate_.FitAt(5, core::AsSpan(seen_), fit_);
      const Eigen::VectorXd v =
          Eigen::Vector2d(1.0, 0.5) + 0.5 * Eigen::Vector2d(random_.Normal(), random_.Normal());
      given_.push_back(v);
      const auto k = static_cast<std::ptrdiff_t>(given_.size()) - 1 - lag;
      if (k >= 0) state_ += truth_ * given_[static_cast<std::size_t>(k)];
      const Eigen::VectorXd before = seen_;
      seen_ = state_ + noise * Eigen::Vector2d(random_.Normal(), random_.Normal());
      Learn(&fit_, before, v, seen_ - before);
    }
  }

  std::vector<Eigen::VectorXd> given_;
  Eigen::VectorXd state_ = Eigen::Vector2d::Zero();
  Eigen::VectorXd seen_ = Eigen::Vector2d::Zero();
};

TEST_P(LagTest, IsFoundAtOnceAndPendingControlsArePredicted) {
  const int lag = GetParam();
  Drive(lag + 1, lag, 0.0);
  EXPECT_EQ(observer_.lag(), lag) << "the first effect reveals it";
  Drive(10, lag, 0.0);
  EXPECT_EQ(observer_.lag(), lag);
  const Eigen::VectorXd& acted = given_[given_.size() - 1 - static_cast<std::size_t>(lag)];
  EXPECT_TRUE(test::AllClose(core::AsVector(observer_.acting()), acted, 0.0));
  estimate_.FitAt(5, core::AsSpan(seen_), fit_);
  EXPECT_TRUE(test::AllClose(fit_.jacobian(), truth_, 0.02));
  Eigen::VectorXd there = seen_;
  Eigen::VectorXd expected = state_;
  {
    const test::NoAlloc guard;
    observer_.Observe(fit_, there);
  }
  for (int i = 0; i < lag; ++i) expected += truth_ * given_[given_.size() - 1 - i];
  EXPECT_TRUE(test::AllClose(there, expected, 0.05));
  observer_.Reset();
  EXPECT_EQ(observer_.lag(), 0);
}

// Noise is mistaken for a lag after at most 1 % of the controls.
TEST_P(LagTest, NoiseIsNotMistakenForALag) {
  int wrong = 0;
  for (int i = 0; i < 200; ++i) {
    Drive(1, 0, 0.1 * GetParam());
    wrong += observer_.lag() != 0 ? 1 : 0;
  }
  EXPECT_LE(wrong, 2);
}

TEST_P(LagTest, ALagThatChangesIsFollowed) {
  Drive(20, GetParam(), 0.0);
  Drive(60, 0, 0.0);
  EXPECT_EQ(observer_.lag(), 0);
}

TEST_P(LagTest, AnInactiveObserverAssumesNoLagAndNoNoise) {
  observer_ = StateObserver(2, 2, kForgetting, /*active=*/false);
  Drive(10, GetParam(), 0.3);
  EXPECT_EQ(observer_.lag(), 0);
  EXPECT_TRUE(test::AllClose(core::AsVector(observer_.acting()), given_.back(), 0.0));
  Eigen::VectorXd there = seen_;
  observer_.Observe(fit_, there);
  EXPECT_TRUE(test::AllClose(there, seen_, 0.0));
}

INSTANTIATE_TEST_SUITE_P(All, LagTest, testing::Values(0, 1, 2, StateObserver::kMaxLag));

// Tests a point with observation noise and a point with process noise.
TEST_F(StateObserverTest, NoiseIsSmoothedAndDisturbancesAreNot) {
  for (const bool noisy : {true, false}) {
    estimate_.Reset();
    observer_.Reset();
    double squared = 0.0;
    double raw = 0.0;
    Eigen::Vector2d state = Eigen::Vector2d::Zero();
    Eigen::VectorXd seen = state;
    for (int i = 0; i < 400; ++i) {
      Eigen::VectorXd smooth = seen;
      observer_.Observe(fit_, smooth);
      if (i >= 50) squared += (smooth - state).squaredNorm();
      if (i >= 50) raw += (seen - state).squaredNorm();
      estimate_.FitAt(5, core::AsSpan(smooth), fit_);
      const Eigen::VectorXd v = Eigen::Vector2d(random_.Normal(), random_.Normal());
      const Eigen::Vector2d other(random_.Normal(), random_.Normal());
      state += truth_ * v;
      if (!noisy) state += 0.3 * other;
      const Eigen::VectorXd before = seen;
      seen = state;
      if (noisy) seen += 0.3 * other;
      Learn(&fit_, before, v, seen - before);
    }
    if (noisy) {
      EXPECT_LT(squared, 0.35 * raw) << "the remaining variance";
    } else {
      EXPECT_LT(squared, 0.02 * 350.0 * 0.3 * 0.3 * 2.0) << "smoothing adds little error";
    }
  }
}

TEST_F(StateObserverTest, WithoutPredictionsTheStateIsTheObservation) {
  for (int i = 0; i < 20; ++i) {
    const Eigen::VectorXd seen = Eigen::Vector2d(i % 2 == 0 ? 0.3 : -0.3, 0.1);
    Eigen::VectorXd z = seen;
    observer_.Observe(fit_, z);
    // Without a fit no control has a prediction.
    EXPECT_TRUE(test::AllClose(z, seen, 0.0));
    Learn(nullptr, seen, Eigen::Vector2d::Zero(), Eigen::Vector2d(i % 2 == 0 ? -0.6 : 0.6, 0.0));
  }
  // The effect of this control overflows, so there is no finite prediction.
  constexpr double kEndless = std::numeric_limits<double>::infinity();
  Learn(&fit_, Eigen::Vector2d::Zero(), Eigen::Vector2d(kEndless, 0.0), Eigen::Vector2d::Zero());
  const Eigen::VectorXd seen = Eigen::Vector2d(0.3, 0.1);
  Eigen::VectorXd z = seen;
  observer_.Observe(fit_, z);
  EXPECT_TRUE(z == seen);
}

// Steps are ten long, and observations err by `noise` with alternating sign.
TEST_F(StateObserverTest, ErrorsBelowOnePercentOfTheChangesAreNotSmoothed) {
  estimate_.FitAt(5, std::vector{0.0, 0.0}, fit_);
  const Eigen::VectorXd v = truth_.inverse() * Eigen::Vector2d(8.0, 6.0);
  const Eigen::Vector2d change = fit_.jacobian() * v;
  for (const double noise : {0.02, 0.5}) {
    observer_.Reset();
    Eigen::VectorXd last = Eigen::Vector2d::Zero();
    Eigen::VectorXd z = last;
    observer_.Observe(fit_, z);
    for (int i = 1; i < 30; ++i) {
      const Eigen::VectorXd seen = i * change + Eigen::Vector2d(i % 2 == 0 ? noise : -noise, 0.0);
      const Eigen::VectorXd dz = seen - last;
      observer_.Update(&fit_, core::AsSpan(v), core::AsSpan(dz));
      z = seen;
      observer_.Observe(fit_, z);
      last = seen;
      if (i > 10) {
        EXPECT_EQ(z == seen, noise < 0.1) << i;
      }
    }
  }
}

// After Reset() an observer equals a new one, bit for bit.
TEST_F(StateObserverTest, ResetRemovesTheLastEpisode) {
  estimate_.FitAt(5, std::vector{0.0, 0.0}, fit_);
  const auto episode = [&] {
    core::Random random(5);
    Eigen::MatrixXd seen = test::RandomMatrix(random, 2, 10);
    for (auto z : seen.colwise()) {
      observer_.Observe(fit_, z);
      const Eigen::VectorXd v = test::RandomMatrix(random, 2, 1);
      const Eigen::VectorXd dz = test::RandomMatrix(random, 2, 1);
      observer_.Update(&fit_, core::AsSpan(v), core::AsSpan(dz));
    }
    return seen;
  };
  const Eigen::MatrixXd first = episode();
  EXPECT_FALSE(episode() == first) << "an observer remembers";
  observer_.Reset();
  EXPECT_TRUE(episode() == first);
}

}  // namespace
}  // namespace dfr::control
