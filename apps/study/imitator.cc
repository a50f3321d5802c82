#include "apps/study/imitator.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "dfr/core/random.h"
#include "dfr/core/text/suggest.h"
#include "dfr/imitation/fit_mlp.h"
#include "dfr/study/policies.h"

namespace dfr::study {
namespace {

// A learned policy, scaled to the units of the task. Control entries that are switches are +-1.
class InUnits final : public core::Policy {
 public:
  InUnits(std::unique_ptr<const core::Policy> learned, const sim::GalleryTask& task)
      : learned_(std::move(learned)), units_(task.units), switches_(task.switches) {}
  [[nodiscard]] int state_dim() const noexcept override { return learned_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return learned_->control_dim(); }
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override {
    learned_->Control(t, x, u);
    for (std::size_t i = 0; i < units_.size(); ++i) u[i] *= units_[i];
    for (const int entry : switches_) {
      double& value = u[static_cast<std::size_t>(entry)];
      value = std::copysign(1.0, value);
    }
  }

 private:
  std::unique_ptr<const core::Policy> learned_;
  std::vector<double> units_;
  std::vector<int> switches_;
};

}  // namespace

const std::vector<std::string>& PolicyNames() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> all = {"good", "weak", "biased"};
    all.insert(all.end(), kPolicies.begin(), kPolicies.end());
    return all;
  }();
  return names;
}

Expert SupervisorOf(const sim::GalleryTask& task) {
  Expert teaching;
  teaching.plant = task.plant;
  teaching.supervise = [](const core::SimulatedPlant& plant, int /*t*/, std::uint64_t episode,
                          std::span<double> u) {
    core::Random random(core::DeriveSeed(episode, {1}));
    const sim::SupervisorVariation variation{.way = random.Uniform(), .offset = random.Normal()};
    static_cast<const sim::GalleryPlant&>(plant).Supervise(variation, u);
  };
  return teaching;
}

Imitator::Imitator(std::shared_ptr<const core::Policy> learned, const sim::PolicyBias& bias)
    : learned_(std::move(learned)), bias_(bias) {
  wanted_.resize(static_cast<std::size_t>(learned_->control_dim()) *
                 static_cast<std::size_t>(bias.late));
}

Imitator::Imitator(std::shared_ptr<OnlineLwrPolicy> online)
    : learned_(online), online_(std::move(online)) {}

void Imitator::Reset(std::uint64_t seed) noexcept {
  if (online_ != nullptr) online_->Reset();
  core::Random random(core::DeriveSeed(seed, {1}));
  share_ = random.Uniform();
  late_ = random.Below(static_cast<std::uint64_t>(bias_.late) + 1) *
          static_cast<std::size_t>(learned_->control_dim());
  std::fill(wanted_.begin(), wanted_.end(), 0.0);
}

void Imitator::Control(int t, std::span<const double> x, std::span<double> u) noexcept {
  if (online_ != nullptr) online_->See(x);
  learned_->Control(t, x, u);
  for (std::size_t i = 0; i < bias_.bias.size(); ++i) u[i] += share_ * bias_.bias[i];
  if (bias_.turn != 0.0) {
    const double c = std::cos(share_ * bias_.turn);
    const double s = std::sin(share_ * bias_.turn);
    const double first = u[0];
    u[0] = c * first - s * u[1];
    u[1] = s * first + c * u[1];
  }
  for (double& entry : u) entry = std::clamp(entry, -1.0, 1.0);
  if (late_ > 0) {
    std::swap_ranges(u.begin(), u.end(), wanted_.begin());
    std::rotate(wanted_.begin(), wanted_.begin() + std::ssize(u),
                wanted_.begin() + static_cast<std::ptrdiff_t>(late_));
  }
}

Imitator Imitate(const sim::GalleryTask& task, std::span<const core::Trajectory> demonstrations,
                 const FittedTask& fit, const core::SimulatedPlant& plant, const std::string& name,
                 std::uint64_t seed) {
  if (std::ranges::count(PolicyNames(), name) == 0) {
    throw core::UnknownName("policy", name, Join(PolicyNames()));
  }
  if (name == kOnlineLwr) {
    return Imitator(
        std::make_shared<OnlineLwrPolicy>(fit.model().features(), fit.ResponseOf(demonstrations)));
  }
  if (auto unlearned = MakeUnlearned(name, fit.model().features(), demonstrations)) {
    return {std::move(unlearned), {}};
  }
  const imitation::DemonstrationSet set{.layout = task.plant->layout(),
                                        .control_dim = task.plant->control_dim(),
                                        .environment = task.name,
                                        .trajectories = {},
                                        .note = {}};
  const bool weak = name == "weak";
  const imitation::FitMlpOptions learner{.hidden = weak ? task.weak_hidden : task.hidden,
                                         .epochs = weak ? task.weak_epochs : task.epochs,
                                         .seed = seed};
  Expert teaching = TeachMlp(set, learner);
  teaching.learn = [learn = std::move(teaching.learn), &task](
                       std::span<const core::Trajectory> shown, std::uint64_t own_seed) {
    std::vector<core::Trajectory> scaled(shown.begin(), shown.end());
    for (core::Trajectory& d : scaled) {
      for (std::size_t i = 0; i < task.units.size(); ++i) {
        d.controls.col(static_cast<Eigen::Index>(i)) /= task.units[i];
      }
    }
    return std::make_unique<const InUnits>(learn(scaled, own_seed), task);
  };
  std::shared_ptr<const core::Policy> learned = teaching.learn(demonstrations, seed);
  if (weak || name == "good") return {std::move(learned), {}};
  if (name == "biased") return {std::move(learned), task.policy_bias};

  const Expert supervisor = SupervisorOf(task);
  teaching.plant = supervisor.plant;
  teaching.supervise = supervisor.supervise;
  for (const core::Trajectory& d : demonstrations) {
    teaching.horizon = std::max(teaching.horizon, 2 * d.num_steps());
  }
  // A policy, and the good policy that some policies borrow.
  struct Made {
    std::shared_ptr<const core::Policy> good;
    std::shared_ptr<const core::Policy> policy;
  };
  const auto made = std::make_shared<Made>();
  made->good = learned;
  made->policy =
      PolicyFactory(fit, *learned, demonstrations, std::move(teaching)).Make(name, &plant);
  return {std::shared_ptr<const core::Policy>(made, made->policy.get()), {}};
}

}  // namespace dfr::study
