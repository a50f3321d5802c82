#include "dfr/study/baselines.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "dfr/core/record.h"

namespace dfr::study {
namespace {

// Streams of Expert::seed.
constexpr std::uint64_t kEnsembleStream = 1;
constexpr std::uint64_t kNoiseStream = 2;
constexpr std::uint64_t kAskingStream = 3;

void CheckSupervisor(const Expert& teaching, const char* name) {
  DFR_THROW_UNLESS(teaching.learn && teaching.plant != nullptr && teaching.supervise,
                   "policy '" << name
                              << "' needs the task's supervisor, which this program does not have "
                                 "here; choose another policy");
}

// Changes the supervisor's control before it is applied.
using Change =
    std::function<void(int t, std::span<const double> x, std::span<double> u, core::Random&)>;

// Runs one episode: returns the visited states and the supervisor's controls there.
core::Trajectory Ask(const Expert& teaching, core::SimulatedPlant& plant, std::uint64_t seed,
                     int horizon, const Change& change) {
  core::Random random(core::DeriveSeed(seed, {2}));  // The supervisor's variation has stream 1.
  plant.Reset(seed);
  std::vector<double> applied(static_cast<std::size_t>(plant.control_dim()));
  core::Trajectory trajectory =
      core::Record(plant, horizon, [&](int t, std::span<const double> x, std::span<double> wanted) {
        teaching.supervise(plant, t, seed, wanted);
        for (double& entry : wanted) entry = std::clamp(entry, -1.0, 1.0);
        std::ranges::copy(wanted, applied.begin());
        change(t, x, applied, random);
        return plant.Apply(applied);
      });
  trajectory.seed = seed;
  return trajectory;
}

// Base of controllers that apply one control per time step: sizes, time step and horizon.
class Stepwise : public control::Controller {
 public:
  Stepwise(const core::Policy& policy, int horizon) : policy_(&policy), horizon_(horizon) {}
  [[nodiscard]] int state_dim() const noexcept override { return policy_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return policy_->control_dim(); }

 protected:
  [[nodiscard]] const core::Policy& policy() const noexcept { return *policy_; }

 private:
  void DoReset(std::uint64_t /*seed*/) noexcept override { t_ = 0; }
  control::Step DoNext(std::span<const double> x, std::span<double> u) noexcept override {
    control::Step step{.t = t_};
    step.cause = t_ == horizon_ ? control::HaltCause::kTimeUp : Decide(t_, x, u, step);
    if (step.cause == control::HaltCause::kNone) {
      step.mode = control::Mode::kPolicy;
      ++t_;
    }
    return step;
  }
  // Writes the control or returns the cause of a halt.
  virtual control::HaltCause Decide(int t, std::span<const double> x, std::span<double> u,
                                    control::Step& step) noexcept = 0;

  const core::Policy* policy_;
  int horizon_;
  int t_ = 0;
};

class EnsembleController final : public Stepwise {
 public:
  EnsembleController(std::shared_ptr<const EnsemblePolicy> ensemble, int horizon)
      : Stepwise(*ensemble, horizon), ensemble_(std::move(ensemble)) {}

 private:
  control::HaltCause Decide(int t, std::span<const double> x, std::span<double> u,
                            control::Step& /*step*/) noexcept override {
    return ensemble_->Mean(t, x, u) > ensemble_->demonstrated_disagreement()
               ? control::HaltCause::kEarlyStopping
               : control::HaltCause::kNone;
  }

  std::shared_ptr<const EnsemblePolicy> ensemble_;
};

class TrueJacobianFilter final : public Stepwise {
 public:
  TrueJacobianFilter(const safety::TaskModel& task, const core::Policy& policy,
                     const core::SimulatedPlant& plant, int horizon)
      : Stepwise(policy, horizon),
        features_(&task.features()),
        support_(&task.feature_support()),
        slack_(task.levels().slack()),
        plant_(&plant),
        copy_(plant.Clone()),
        state_(plant.state_dim()),
        z_(features_->num_features()),
        gradient_(z_.size()),
        direction_(plant.control_dim()),
        tried_(plant.control_dim()),
        effect_(z_.size()),
        jacobian_(z_.size(), plant.control_dim()) {}

 private:
  static constexpr double kDifference = 1e-3;  // Step of finite differences, in units of controls.
  static constexpr int kIterations = 6;

  control::HaltCause Decide(int t, std::span<const double> x, std::span<double> u,
                            control::Step& step) noexcept override {
    policy().Control(t, x, u);
    if (!core::AllFinite(u)) return control::HaltCause::kControlInvalid;
    double level = LevelAfter(t, u);
    if (level < 0.0) {
      if (!Differentiate(u)) return control::HaltCause::kPlantFault;
      for (int i = 0; i < kIterations && level < 0.0 && Raise(t, u, level); ++i) {
        step.filtered = true;
      }
    }
    return level < -slack_ ? control::HaltCause::kOutsideSupport : control::HaltCause::kNone;
  }

  // Computes the features of the state after `u`. Returns false if the plant rejects `u`.
  bool Try(std::span<const double> u, Eigen::VectorXd& z) noexcept {
    copy_->CopyStateFrom(*plant_);
    if (copy_->Apply(u) != core::PlantStatus::kOk) return false;
    copy_->Observe(core::AsSpan(state_));
    features_->Apply(core::AsSpan(std::as_const(state_)), core::AsSpan(z));
    return true;
  }

  // Returns l after `u`, or -infinity if the plant rejects `u`. Writes the gradient to gradient_.
  double LevelAfter(int t, std::span<const double> u) noexcept {
    if (!Try(u, z_)) return -std::numeric_limits<double>::infinity();
    return support_->LogDecision(t + 1, core::AsSpan(std::as_const(z_)), core::AsSpan(gradient_));
  }

  // Computes the Jacobian of the features of the next state with respect to the control, at `u`,
  // which leads to z_.
  bool Differentiate(std::span<const double> u) noexcept {
    for (Eigen::Index k = 0; k < tried_.size(); ++k) {
      tried_ = core::AsVector(u);
      // The difference points away from saturation.
      const double h = tried_[k] > 0.0 ? -kDifference : kDifference;
      tried_[k] += h;
      if (!Try(core::AsSpan(std::as_const(tried_)), effect_)) return false;
      jacobian_.col(k) = (effect_ - z_) / h;
    }
    return true;
  }

  // Takes the step that is optimal for the curvature bound, as in control::AscendSupport(), but not
  // beyond l = 0 in the linear model. Returns false if l does not rise on the plant.
  bool Raise(int t, std::span<double> u, double& level) noexcept {
    direction_.noalias() = jacobian_.transpose() * gradient_;
    const double square = direction_.squaredNorm();
    if (!(square > 0.0)) return false;
    effect_.noalias() = jacobian_ * direction_;
    const double bend = support_->curvature_bound(t + 1) * effect_.squaredNorm();
    const double best = bend > 0.0 ? square / (2.0 * bend) : -level / square;
    tried_ = (core::AsVector(u) + std::min(best, -level / square) * direction_)
                 .cwiseMax(-1.0)
                 .cwiseMin(1.0);
    const double reached = LevelAfter(t, core::AsSpan(std::as_const(tried_)));
    if (!(reached > level)) return false;
    level = reached;
    core::AsVector(u) = tried_;
    return true;
  }

  const core::FeatureTransform* features_;
  const core::LogDecisionFunction* support_;
  double slack_;
  const core::SimulatedPlant* plant_;
  std::unique_ptr<core::SimulatedPlant> copy_;
  Eigen::VectorXd state_;
  Eigen::VectorXd z_;
  Eigen::VectorXd gradient_;
  Eigen::VectorXd direction_;
  Eigen::VectorXd tried_;
  Eigen::VectorXd effect_;
  Eigen::MatrixXd jacobian_;
};

}  // namespace

Expert TeachMlp(const imitation::DemonstrationSet& like, const imitation::FitMlpOptions& options) {
  Expert teaching;
  teaching.seed = options.seed;
  imitation::DemonstrationSet empty{.layout = like.layout,
                                    .control_dim = like.control_dim,
                                    .environment = like.environment,
                                    .trajectories = {},
                                    .note = {}};
  teaching.learn = [empty = std::move(empty), options](
                       std::span<const core::Trajectory> demonstrations, std::uint64_t seed) {
    imitation::DemonstrationSet set = empty;
    set.trajectories.assign(demonstrations.begin(), demonstrations.end());
    imitation::FitMlpOptions fit = options;
    fit.seed = seed;
    return std::make_unique<const imitation::MlpPolicy>(imitation::FitMlp(set, fit));
  };
  return teaching;
}

EnsemblePolicy::EnsemblePolicy(const Expert& teaching,
                               std::span<const core::Trajectory> demonstrations) {
  DFR_THROW_UNLESS(
      teaching.learn,
      "an ensemble needs a learner, which this program does not have here; choose another policy");
  const std::uint64_t seed = core::DeriveSeed(teaching.seed, {kEnsembleStream});
  core::Random random(seed);
  for (std::uint64_t i = 0; i < kMembers; ++i) {
    std::vector<core::Trajectory> drawn(demonstrations.size());
    for (core::Trajectory& d : drawn) d = demonstrations[random.Below(demonstrations.size())];
    members_.push_back(teaching.learn(drawn, core::DeriveSeed(seed, {i})));
  }
  DFR_THROW_UNLESS(control_dim() <= kMostControls, "an ensemble takes controls of at most "
                                                       << kMostControls << " entries, not "
                                                       << control_dim());
  std::vector<double> u(static_cast<std::size_t>(control_dim()));
  for (const core::Trajectory& d : demonstrations) {
    for (int t = 0; t < d.num_steps(); ++t) {
      demonstrated_ = std::max(demonstrated_, Mean(t, core::Row(d.states, t), u));
    }
  }
}

double EnsemblePolicy::Mean(int t, std::span<const double> x, std::span<double> u) const noexcept {
  std::array<double, std::size_t{kMembers} * kMostControls> each;
  const std::size_t m = u.size();
  std::ranges::fill(u, 0.0);
  for (std::size_t i = 0; i < members_.size(); ++i) {
    const std::span<double> one = std::span(each).subspan(i * m, m);
    members_[i]->Control(t, x, one);
    core::AsVector(u) += core::AsVector(one) / kMembers;
  }
  double squares = 0.0;
  for (std::size_t i = 0; i < members_.size(); ++i) {
    squares +=
        (core::AsVector(std::span(each).subspan(i * m, m)) - core::AsVector(u)).squaredNorm();
  }
  return std::sqrt(squares / kMembers);
}

std::unique_ptr<control::Controller> MakeEnsembleController(
    std::shared_ptr<const EnsemblePolicy> ensemble, int horizon) {
  return std::make_unique<EnsembleController>(std::move(ensemble), horizon);
}

std::unique_ptr<const core::Policy> TrainDart(const Expert& teaching, const core::Policy& learned,
                                              std::span<const core::Trajectory> demonstrations,
                                              int horizon) {
  constexpr int kPilots = 10;
  CheckSupervisor(teaching, "dart");
  const std::uint64_t seed = core::DeriveSeed(teaching.seed, {kNoiseStream});
  const std::unique_ptr<core::SimulatedPlant> plant = teaching.plant->Clone();
  const Eigen::Index m = learned.control_dim();
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(m, m);
  Eigen::VectorXd error(m);
  int pairs = 0;
  for (std::uint64_t i = 0; i < kPilots; ++i) {
    static_cast<void>(
        Ask(teaching, *plant, core::DeriveSeed(seed, {0, i}), horizon,
            [&](int t, std::span<const double> x, std::span<double> u, core::Random& /*random*/) {
              learned.Control(t, x, core::AsSpan(error));
              error -= core::AsVector(u);
              covariance += error * error.transpose();
              ++pairs;
            }));
  }
  covariance /= std::max(1, pairs);
  // Regularisation keeps the covariance positive definite.
  covariance.diagonal().array() += 1e-12;
  const Eigen::MatrixXd root = covariance.llt().matrixL();
  Eigen::VectorXd noise(m);
  std::vector<core::Trajectory> noisy;
  noisy.reserve(demonstrations.size());
  const std::size_t most = 10 * demonstrations.size() + 100;
  for (std::uint64_t i = 0; noisy.size() < demonstrations.size(); ++i) {
    DFR_THROW_UNLESS(i < most,
                     "policy 'dart': with the learned policy's errors as noise the "
                     "supervisor completes fewer than one episode in ten");
    core::Trajectory trajectory = Ask(
        teaching, *plant, core::DeriveSeed(seed, {1, i}), horizon,
        [&](int /*t*/, std::span<const double> /*x*/, std::span<double> u, core::Random& random) {
          for (double& entry : noise) entry = random.Normal();
          core::AsVector(u) += root * noise;
          for (double& entry : u) entry = std::clamp(entry, -1.0, 1.0);
        });
    if (trajectory.outcome == core::Outcome::kCompleted && trajectory.num_steps() > 0) {
      noisy.push_back(std::move(trajectory));
    }
  }
  return teaching.learn(noisy, core::DeriveSeed(seed, {2}));
}

std::unique_ptr<const core::Policy> TrainDagger(const Expert& teaching, const core::Policy& learned,
                                                std::span<const core::Trajectory> demonstrations,
                                                int horizon) {
  constexpr std::uint64_t kRounds = 10;
  CheckSupervisor(teaching, "dagger");
  const std::uint64_t seed = core::DeriveSeed(teaching.seed, {kAskingStream});
  const std::unique_ptr<core::SimulatedPlant> plant = teaching.plant->Clone();
  std::vector<core::Trajectory> all(demonstrations.begin(), demonstrations.end());
  all.reserve(2 * all.size());
  std::unique_ptr<const core::Policy> latest;
  for (std::uint64_t round = 0; round < kRounds; ++round) {
    const core::Policy& policy = latest != nullptr ? *latest : learned;
    const std::uint64_t end = (round + 1) * demonstrations.size() / kRounds;
    for (std::uint64_t i = round * demonstrations.size() / kRounds; i < end; ++i) {
      core::Trajectory trajectory = Ask(teaching, *plant, core::DeriveSeed(seed, {0, i}), horizon,
                                        [&](int t, std::span<const double> x, std::span<double> u,
                                            core::Random& /*random*/) { policy.Control(t, x, u); });
      if (trajectory.num_steps() > 0) all.push_back(std::move(trajectory));
    }
    latest = teaching.learn(all, core::DeriveSeed(seed, {1, round}));
  }
  return latest;
}

std::unique_ptr<control::Controller> MakeTrueJacobianFilter(const safety::TaskModel& task,
                                                            const core::Policy& policy,
                                                            const core::SimulatedPlant& plant,
                                                            int horizon) {
  return std::make_unique<TrueJacobianFilter>(task, policy, plant, horizon);
}

}  // namespace dfr::study
