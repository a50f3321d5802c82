#include <array>
#include <cstdio>
#include <fstream>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "commands.h"
#include "dfr/control/guided/guided_policy.h"
#include "dfr/control/rollout.h"
#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"
#include "dfr/core/policy.h"
#include "dfr/safety/guard_model.h"

namespace dfr::apps::pusher {
namespace {

// u = b + W x, from a text of control_dim rows: b, then W.
class LinearPolicy final : public core::Policy {
 public:
  LinearPolicy(const std::filesystem::path& path, int state_dim, int control_dim)
      : gains_(control_dim, state_dim + 1) {
    std::ifstream in(path);
    if (!in) throw std::runtime_error(path.string() + ": cannot be opened");
    for (Eigen::Index i = 0; i < gains_.size(); ++i) in >> gains_.data()[i];
    double more = 0.0;
    if (!in || in >> more) {
      throw std::runtime_error(path.string() + ": does not hold " + std::to_string(control_dim) +
                               " rows of " + std::to_string(state_dim + 1) +
                               " numbers, an offset and a gain per state entry");
    }
  }
  [[nodiscard]] int state_dim() const noexcept override {
    return static_cast<int>(gains_.cols()) - 1;
  }
  [[nodiscard]] int control_dim() const noexcept override {
    return static_cast<int>(gains_.rows());
  }
  // One product after the other: a matrix product may add up in another order, and other programs
  // are to get the same bits.
  void Control(int /*t*/, std::span<const double> x, std::span<double> u) const noexcept override {
    for (Eigen::Index i = 0; i < gains_.rows(); ++i) {
      double sum = gains_(i, 0);
      for (std::size_t k = 0; k < x.size(); ++k) {
        sum += gains_(i, static_cast<Eigen::Index>(k) + 1) * x[k];
      }
      u[static_cast<std::size_t>(i)] = sum;
    }
  }

 private:
  core::Matrix gains_;
};

class LastState final : public control::RolloutObserver {
 public:
  void OnStart(std::span<const double> x) override { x_.assign(x.begin(), x.end()); }
  void OnControl(const control::RolloutEvent& event) override {
    x_.assign(event.next_x.begin(), event.next_x.end());
  }
  [[nodiscard]] const std::vector<double>& x() const { return x_; }

 private:
  std::vector<double> x_;
};

}  // namespace

void RunGuarded(const GuardedOptions& options) {
  const auto model = safety::GuardModel::Load(options.guard);
  const safety::GuardSettings& settings = model->settings();
  sim::PusherPlant plant(options.plant);
  DFR_THROW_UNLESS(model->layout() == plant.layout(),
                   options.guard.string() << ": is a guard of other states than the Pusher's");
  DFR_THROW_UNLESS(settings.strategy == safety::Strategy::kGuided,
                   options.guard.string() << ": its strategy is '" << Name(settings.strategy)
                                          << "'; only guided recovery is rolled out here");
  const LinearPolicy policy(options.policy, plant.state_dim(), plant.control_dim());
  control::GuidedPolicy guided(policy, model->recovery().model(),
                               {.horizon = settings.horizon,
                                .max_controls = settings.max_actions,
                                .control_limit = settings.action_limit});
  std::printf("seed outcome controls state\n");
  std::array<int, 3> counts = {};
  for (int i = 0; i < options.episodes; ++i) {
    const std::uint64_t seed = options.seed + static_cast<std::uint64_t>(i);
    LastState last;
    const auto result =
        control::Rollout(plant, guided, {.plant_seed = seed, .controller_seed = seed}, &last);
    ++counts[static_cast<std::size_t>(result.outcome)];
    std::printf("%llu %s %d", static_cast<unsigned long long>(seed), Name(result.outcome),
                result.controls());
    for (const double x : last.x()) std::printf(" %.17g", x);
    std::printf("\n");
  }
  std::fprintf(stderr, "%d completed, %d halted, %d collided\n", counts[0], counts[1], counts[2]);
}

}  // namespace dfr::apps::pusher
