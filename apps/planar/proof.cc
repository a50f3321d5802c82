#include "apps/planar/proof.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <vector>

#include "dfr/control/guided_model.h"
#include "dfr/control/guided_policy.h"
#include "dfr/core/random.h"
#include "dfr/kernel/whitened_support.h"

namespace dfr::apps::planar {
namespace {

constexpr int kPhases = 12;

// Demonstrations of a cloud that wanders, bends and changes its width.
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
    // Controls that the states do not follow from: J is as wrong as can be.
    for (double& u : trajectory.controls.reshaped()) u = random.Uniform(-1.0, 1.0);
    demonstrations.push_back(std::move(trajectory));
  }
  return demonstrations;
}

// Runs from the centre of the support at t, straight on, or anywhere, by episode.
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

}  // namespace

ProofResult Prove(control::CertificateKind kind, std::int64_t steps, std::uint64_t seed) {
  ProofResult result;
  result.least = std::numeric_limits<double>::infinity();
  const double gain = 0.7;  // K, and eps
  for (std::uint64_t world = 0; result.controls < steps; ++world) {
    core::Random random(core::DeriveSeed(seed, {static_cast<std::uint64_t>(kind), world}));
    const int dim = 2 + static_cast<int>(random.Below(3));
    const auto demonstrations = Wander(dim, random);
    const auto features = core::FeatureTransform::Identity(core::FeatureSelection::All(dim));
    std::vector<core::Matrix> states;
    states.reserve(demonstrations.size());
    for (const auto& d : demonstrations) states.push_back(d.states);
    const auto support =
        kernel::WhitenedSupport::Fit(states, {.svm = {.nu = 0.1, .gamma = random.Uniform(0.1, 1.5)},
                                              .window = static_cast<int>(random.Below(3)),
                                              .phase_whitening = random.Below(2) == 0});
    // Half of the worlds know nothing of J and probe.
    control::GuidedModelOptions knowledge;
    if (random.Below(2) == 0) knowledge.jacobian.prior_weight = 0.0;
    const control::GuidedModel model(features, support, demonstrations, knowledge);
    control::GuidedOptions options;
    options.horizon = 60;
    options.certificate = {kind, gain, gain};
    Adversary policy(dim, random);
    control::GuidedPolicy controller(policy, model, options);

    const auto n = static_cast<std::size_t>(dim);
    std::vector<double> z(n), u(n), direction(n), gradient(n);
    for (int episode = 0; episode < 40 && result.controls < steps; ++episode) {
      policy.manner = static_cast<int>(random.Below(3));
      const bool worst = random.Below(2) == 0;
      const auto& start = demonstrations[random.Below(demonstrations.size())].states;
      for (std::size_t i = 0; i < n; ++i) z[i] = start(0, static_cast<Eigen::Index>(i));
      controller.Reset(random());
      ++result.episodes;
      int phase = 0;
      while (result.controls < steps) {
        const control::Step step = controller.Next(z, u);
        if (step.mode == control::Mode::kHalt) {
          if (step.cause == control::HaltCause::kViolated) ++result.violations;
          break;
        }
        ++result.controls;
        result.phases += step.t > phase ? 1 : 0;
        phase = step.t;
        result.probes += step.mode == control::Mode::kProbe ? 1 : 0;
        result.recoveries += step.mode == control::Mode::kRecovery ? 1 : 0;
        result.filtered += step.filtered ? 1 : 0;
        double norm = 0.0;
        for (const double entry : u) norm = std::hypot(norm, entry);
        random.Direction(direction);
        if (worst) {
          support.LogDecision(phase, z, gradient);
          double length = 0.0;
          for (const double entry : gradient) length = std::hypot(length, entry);
          if (length > 0.0) {
            for (std::size_t i = 0; i < n; ++i) direction[i] = -gradient[i] / length;
          }
        }
        // A hair less than allowed: the last digit of a sum of rounded terms is nobody's claim.
        const double kick = gain * norm * (1.0 - 1e-12) * (worst ? 1.0 : random.Uniform());
        if (kind == control::CertificateKind::kDirection) {
          for (int i = 0; i < dim; ++i) {
            for (int k = 0; k < dim; ++k) {
              z[static_cast<std::size_t>(i)] += controller.jacobian()(i, k) *
                                                u[static_cast<std::size_t>(k)] /
                                                model.control_unit();
            }
          }
        }
        for (std::size_t i = 0; i < n; ++i) z[i] += kick * direction[i];
        double best = -std::numeric_limits<double>::infinity();
        for (int t = 0; t < support.num_steps(); ++t) {
          best = std::max(best, support.LogDecision(t, z, {}));
        }
        result.least = std::min(result.least, best);
        // l is a difference of logarithms, each right to a few units of 1e-16.
        if (best < -1e-12) ++result.left;
      }
    }
  }
  return result;
}

}  // namespace dfr::apps::planar
