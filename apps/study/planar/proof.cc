#include "apps/study/planar/proof.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "dfr/control/certified/certified_controller.h"
#include "dfr/control/guided/task_view.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "dfr/kernel/whitened_support.h"

namespace dfr::study::planar {
namespace {

constexpr int kPhases = 12;
constexpr double kError = 0.7;  // eps

// The supports of a world, with the curvature bound of a controller that has a mistake.
class Mistaken final : public core::LogDecisionFunction {
 public:
  Mistaken(const core::LogDecisionFunction& inner, Mutation mutation)
      : inner_(&inner), mutation_(mutation) {}
  int state_dim() const noexcept override { return inner_->state_dim(); }
  int num_steps() const noexcept override { return inner_->num_steps(); }
  double Decision(int t, std::span<const double> z) const noexcept override {
    return inner_->Decision(t, z);
  }
  double Gradient(int t, std::span<const double> z,
                  std::span<double> gradient) const noexcept override {
    return inner_->Gradient(t, z, gradient);
  }
  double LogDecision(int t, std::span<const double> z,
                     std::span<double> gradient) const noexcept override {
    return inner_->LogDecision(t, z, gradient);
  }
  double FromLog(int t, double l) const noexcept override { return inner_->FromLog(t, l); }
  double curvature_bound(int t) const noexcept override {
    return (mutation_ == Mutation::kCurvature ? 0.98 : 1.0) * inner_->curvature_bound(t);
  }

 private:
  const core::LogDecisionFunction* inner_;
  Mutation mutation_;
};

// A single Gaussian at the mean of each time step. Its boundary is its steepest part, where it
// attains L and the curvature bound.
kernel::WhitenedSupport SingleKernels(std::span<const core::Matrix> states, double gamma) {
  std::vector<kernel::WhitenedSupport::Estimate> estimates;
  const Eigen::Index n = states[0].cols();
  for (int t = 0; t <= kPhases; ++t) {
    core::Matrix centre = core::Matrix::Zero(1, n);
    for (const core::Matrix& s : states) centre += s.row(t) / static_cast<double>(states.size());
    estimates.push_back({core::Matrix::Identity(n, n),
                         kernel::OneClassSvm::FromParts(centre, Eigen::VectorXd::Ones(1), gamma,
                                                        std::exp(-0.5), 1.0)});
  }
  return kernel::WhitenedSupport(std::move(estimates));
}

double LargestLevel(const core::LogDecisionFunction& support, std::span<const double> z, int lost) {
  double best = -std::numeric_limits<double>::infinity();
  for (int t = 0; t < support.num_steps(); ++t) {
    if (t != lost) best = std::max(best, support.LogDecision(t, z, {}));
  }
  return best;
}

// Finds the direction in which the largest level over all supports is least at distance `reach`
// from z. Follows each support's steepest descent from z for a few rounds.
void WorstDirection(const core::LogDecisionFunction& support, std::span<const double> z,
                    double reach, int lost, std::span<double> direction) {
  const auto n = static_cast<Eigen::Index>(z.size());
  Eigen::VectorXd gradient(n);
  Eigen::VectorXd there(n);
  double least = std::numeric_limits<double>::infinity();
  constexpr int kRounds = 3;
  for (int t = 0; t < support.num_steps(); ++t) {
    there = core::AsVector(z);
    for (int round = 0; round < kRounds; ++round) {
      // From the second round on, q is the support with the largest level at `there`.
      int q = t;
      for (int other = 0; round > 0 && other < support.num_steps(); ++other) {
        if (other != lost && support.LogDecision(other, core::AsSpan(there), {}) >
                                 support.LogDecision(q, core::AsSpan(there), {})) {
          q = other;
        }
      }
      support.LogDecision(q, core::AsSpan(there), core::AsSpan(gradient));
      if (!(gradient.norm() > 0.0)) break;
      // Halfway between the previous direction and the new one.
      const Eigen::VectorXd way = (there - core::AsVector(z)) / reach - gradient / gradient.norm();
      if (!(way.norm() > 0.0)) break;
      there = core::AsVector(z) + reach * way / way.norm();
      const double level = LargestLevel(support, core::AsSpan(there), lost);
      if (level < least) {
        least = level;
        core::AsVector(direction) = way / way.norm();
      }
    }
  }
}

// Demonstrations of a point cloud that moves, bends and changes its width.
std::vector<core::Trajectory> Wander(int dim, core::Random& random) {
  std::vector<core::Trajectory> demonstrations;
  std::vector<double> speed(static_cast<std::size_t>(dim));
  for (double& s : speed) s = random.Uniform(-0.5, 0.5);
  const double turn = random.Uniform(-0.4, 0.4);
  const double spread = random.Uniform(0.3, 1.2);
  for (int d = 0; d < 24; ++d) {
    core::Trajectory trajectory;
    trajectory.states.resize(kPhases + 1, dim);
    trajectory.controls.resize(kPhases, dim);
    for (int t = 0; t <= kPhases; ++t) {
      for (int k = 0; k < dim; ++k) {
        const double bend = k == 0 ? 0.0 : std::sin(turn * t);
        trajectory.states(t, k) = speed[static_cast<std::size_t>(k)] * t + bend +
                                  spread * (1.0 + 0.5 * std::sin(0.7 * t)) * random.Normal();
      }
    }
    // The states do not follow from these controls, so J is wrong.
    for (double& u : trajectory.controls.reshaped()) u = random.Uniform(-1.0, 1.0);
    demonstrations.push_back(std::move(trajectory));
  }
  return demonstrations;
}

// Moves randomly, away from the origin, or along the first axis, depending on the episode.
class Adversary final : public core::Policy {
 public:
  Adversary(int dim, core::Random& random) : dim_(dim), random_(&random) {}
  int state_dim() const noexcept override { return dim_; }
  int control_dim() const noexcept override { return dim_; }
  void Control(int /*t*/, std::span<const double> x, std::span<double> u) const noexcept override {
    const double size = random_->Uniform(0.0, 2.0);
    if (manner == 0) {
      random_->Direction(u);
    } else if (manner == 1) {
      double norm = 1e-12;
      for (const double entry : x) norm = std::hypot(norm, entry);
      for (std::size_t i = 0; i < u.size(); ++i) u[i] = x[i] / norm;
    } else {
      std::fill(u.begin(), u.end(), 0.0);
      u[0] = 1.0;
    }
    for (double& entry : u) entry *= size;
  }
  int manner = 0;

 private:
  int dim_;
  core::Random* random_;
};

// Direction of an adversarial plant's error, within |dz - J u| <= eps |u|.
enum class Malice { kRandom, kAwayFromThePhase, kAwayFromAll };

class World {
 public:
  World(const ProofOptions& options, std::uint64_t world)
      : options_(options),
        random_(core::DeriveSeed(options.seed, {3, world})),
        dim_(2 + static_cast<int>(
                     random_.Below(static_cast<std::uint64_t>(options.most_dimensions - 1)))),
        demonstrations_(Wander(dim_, random_)),
        support_(MakeSupport(world % 3 == 0)),
        seen_(support_, options.mutation),
        features_(core::FeatureTransform::Identity(core::FeatureSelection::All(dim_))),
        levels_(seen_, control::FeatureTrajectories(features_, demonstrations_).points),
        response_(control::FeatureTrajectories(features_, demonstrations_), Knowledge()),
        policy_(dim_, random_),
        controller_(policy_, {features_, seen_, levels_, response_}, Options()),
        lost_(Lost(options.mutation, world)) {}

  void Episode(ProofResult& result) {
    const auto n = static_cast<std::size_t>(dim_);
    std::vector<double> z(n), observed(n), u(n), direction(n);
    policy_.manner = static_cast<int>(random_.Below(3));
    const auto malice = static_cast<Malice>(random_.Below(3));
    const auto& start = demonstrations_[random_.Below(demonstrations_.size())].states;
    for (std::size_t i = 0; i < n; ++i) z[i] = start(0, static_cast<Eigen::Index>(i));
    observed = z;
    controller_.Reset(random_());
    ++result.episodes;
    int phase = 0;
    while (result.controls < options_.steps) {
      const control::Step step = controller_.Next(observed, u);
      if (step.mode == control::Mode::kHalt) {
        if (step.cause == control::HaltCause::kViolated) ++result.violations;
        return;
      }
      ++result.controls;
      result.phases += step.t > phase ? 1 : 0;
      phase = step.t;
      result.probes += step.mode == control::Mode::kProbe ? 1 : 0;
      result.recoveries += step.mode == control::Mode::kRecovery ? 1 : 0;
      result.filtered += step.filtered ? 1 : 0;
      const Eigen::VectorXd issued = core::AsVector(std::span<const double>(u));
      core::AsVector(std::span<double>(z)) +=
          controller_.jacobian() * issued / response_.control_unit();
      // Slightly less than allowed, because the last digit of a rounded sum is not exact. A larger
      // factor is rare, because the check for violations would otherwise end each episode at once.
      const double excess = random_.Below(8) == 0 ? Excess() : 1.0;
      const double reach = kError * excess * issued.norm() * (1.0 - 1e-12);
      random_.Direction(direction);
      if (malice == Malice::kAwayFromThePhase) {
        support_.LogDecision(phase, z, direction);
        core::AsVector(std::span<double>(direction)) *= -1.0;
        core::AsVector(std::span<double>(direction)).normalize();
      } else if (malice == Malice::kAwayFromAll && reach > 0.0) {
        WorstDirection(support_, z, reach, lost_, direction);
      }
      const double size = malice == Malice::kRandom ? random_.Uniform() : 1.0;
      for (std::size_t i = 0; i < n; ++i) z[i] += size * reach * direction[i];
      const double best = LargestLevel(support_, z, lost_);
      result.least = std::min(result.least, best);
      // l is a difference of logarithms, each accurate to a few units of 1e-16.
      if (best < -1e-12) ++result.left;
      observed = z;
      if (options_.state_error > 0.0) {
        random_.Direction(direction);
        for (std::size_t i = 0; i < n; ++i) {
          observed[i] += options_.state_error * (1.0 - 1e-12) * direction[i];
        }
      }
    }
  }

 private:
  // Selects a phase at either end, whose states are in no other support.
  static int Lost(Mutation mutation, std::uint64_t world) {
    if (mutation != Mutation::kLostPhase) return -1;
    return world % 2 == 0 ? 0 : kPhases;
  }

  // Factor by which the plant exceeds the controller's assumption.
  [[nodiscard]] double Excess() const {
    if (options_.mutation == Mutation::kShare) return 1.0 + 1e-5;
    return options_.mutation == Mutation::kConstant ? 1.02 : 1.0;
  }

  kernel::WhitenedSupport MakeSupport(bool single) {
    std::vector<core::Matrix> states;
    states.reserve(demonstrations_.size());
    for (const auto& d : demonstrations_) states.push_back(d.states);
    // The kernel has about the same width in any number of dimensions.
    const double gamma = random_.Uniform(0.1, 1.5) * 2.0 / dim_;
    if (single) return SingleKernels(states, gamma);
    return kernel::WhitenedSupport::Fit(states, {.svm = {.nu = 0.1, .gamma = gamma},
                                                 .window = static_cast<int>(random_.Below(3)),
                                                 .phase_whitening = random_.Below(2) == 0});
  }

  // In half of the worlds the controller has no estimate of J and must probe.
  control::ResponseOptions Knowledge() {
    control::ResponseOptions knowledge;
    if (random_.Below(2) == 0) knowledge.prior_weight = 0.0;
    return knowledge;
  }

  [[nodiscard]] control::CertifiedOptions Options() const {
    return {.horizon = 60,
            .certificate = {.direction_error = kError * options_.assumed,
                            .state_error = options_.state_error}};
  }

  ProofOptions options_;
  core::Random random_;
  int dim_;
  std::vector<core::Trajectory> demonstrations_;
  kernel::WhitenedSupport support_;
  Mistaken seen_;
  core::FeatureTransform features_;
  control::Levels levels_;
  control::Response response_;
  Adversary policy_;
  control::CertifiedController controller_;
  int lost_;
};

}  // namespace

const char* Name(Mutation mutation) noexcept {
  switch (mutation) {
    case Mutation::kNone:
      return "none";
    case Mutation::kShare:
      return "share";
    case Mutation::kConstant:
      return "constant";
    case Mutation::kCurvature:
      return "curvature";
    case Mutation::kLostPhase:
      return "lost-phase";
  }
  return "unknown";
}

ProofResult Prove(const ProofOptions& options) {
  ProofResult result;
  result.least = std::numeric_limits<double>::infinity();
  for (std::uint64_t number = 0; result.controls < options.steps; ++number) {
    World world(options, number);
    for (int episode = 0; episode < 40 && result.controls < options.steps; ++episode) {
      world.Episode(result);
    }
  }
  return result;
}

}  // namespace dfr::study::planar
