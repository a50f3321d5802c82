// Rollouts of a linear policy on the Pusher, guided inside the support of a guard's file, as the
// program `pusher` does with its own models. Prints a line per seed: outcome, controls, last state.
// usage: pusher_rollouts GUARD POLICY SEEDS, POLICY a text of control_dim rows, offset first.
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <fstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "dfr/control/guided_policy.h"
#include "dfr/control/rollout.h"
#include "dfr/core/matrix.h"
#include "dfr/safety/guard_model.h"
#include "dfr/sim/pusher/pusher_plant.h"

namespace {

class LinearPolicy final : public dfr::core::Policy {
 public:
  LinearPolicy(const std::string& path, int state_dim, int control_dim)
      : weights_(control_dim, state_dim + 1) {
    std::ifstream in(path);
    for (Eigen::Index i = 0; i < weights_.size(); ++i) in >> weights_.data()[i];
    if (!in) throw std::runtime_error(path + ": holds too few numbers");
  }
  [[nodiscard]] int state_dim() const noexcept override {
    return static_cast<int>(weights_.cols()) - 1;
  }
  [[nodiscard]] int control_dim() const noexcept override {
    return static_cast<int>(weights_.rows());
  }
  // In the order in which the test adds up, for the same bits.
  void Control(int /*t*/, std::span<const double> x, std::span<double> u) const noexcept override {
    for (Eigen::Index i = 0; i < weights_.rows(); ++i) {
      double sum = weights_(i, 0);
      for (std::size_t k = 0; k < x.size(); ++k) {
        sum += weights_(i, static_cast<Eigen::Index>(k) + 1) * x[k];
      }
      u[static_cast<std::size_t>(i)] = sum;
    }
  }

 private:
  dfr::core::Matrix weights_;
};

class LastState final : public dfr::control::RolloutObserver {
 public:
  void OnStart(std::span<const double> x) override { x_.assign(x.begin(), x.end()); }
  void OnControl(const dfr::control::RolloutEvent& event) override {
    x_.assign(event.next_x.begin(), event.next_x.end());
  }
  [[nodiscard]] const std::vector<double>& x() const { return x_; }

 private:
  std::vector<double> x_;
};

}  // namespace

int main(int argc, char** argv) try {
  if (argc != 4) throw std::runtime_error("usage: pusher_rollouts GUARD POLICY SEEDS");
  const auto model = dfr::safety::GuardModel::Load(argv[1]);
  const dfr::safety::GuardSettings& settings = model->settings();
  dfr::sim::PusherPlant plant;
  const LinearPolicy policy(argv[2], plant.state_dim(), plant.control_dim());
  dfr::control::GuidedPolicy guided(policy, model->recovery().model(),
                                    {.horizon = settings.horizon,
                                     .max_controls = settings.max_actions,
                                     .control_limit = settings.action_limit});
  for (std::uint64_t seed = 0; seed < std::strtoull(argv[3], nullptr, 10); ++seed) {
    LastState last;
    const auto result =
        dfr::control::Rollout(plant, guided, {.plant_seed = seed, .controller_seed = seed}, &last);
    std::printf("%s %d", Name(result.outcome), result.controls());
    for (const double x : last.x()) std::printf(" %.17g", x);
    std::printf("\n");
  }
} catch (const std::exception& e) {
  std::fprintf(stderr, "pusher_rollouts: %s\n", e.what());
  return EXIT_FAILURE;
}
