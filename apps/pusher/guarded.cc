#include <array>
#include <cstdio>
#include <fstream>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "commands.h"
#include "dfr/control/controller.h"
#include "dfr/core/contract.h"
#include "dfr/core/files/read_file.h"
#include "dfr/core/matrix.h"
#include "dfr/core/policy.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_model.h"

namespace dfr::apps::pusher {
namespace {

// u = b + W x. Each row of the text has an entry of b, then a row of W.
class LinearPolicy final : public core::Policy {
 public:
  LinearPolicy(const std::filesystem::path& path, int state_dim, int control_dim)
      : gains_(control_dim, state_dim + 1) {
    core::CheckPlainFile(path);
    std::ifstream in(path);
    if (!in) throw std::runtime_error(path.string() + ": cannot be opened");
    for (Eigen::Index i = 0; i < gains_.size(); ++i) in >> gains_.data()[i];
    if (!in || !(in >> std::ws).eof()) {
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
  // Adds the products one by one, because a matrix product may use another order, and other
  // programs must compute the same bits.
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

}  // namespace

void RunGuarded(const GuardedOptions& options) {
  const auto model = safety::GuardModel::Load(options.guard);
  sim::PusherPlant plant(options.plant);
  DFR_THROW_UNLESS(model->layout() == plant.layout(),
                   options.guard.string() << ": is not a guard of the Pusher's states");
  const LinearPolicy policy(options.policy, plant.state_dim(), plant.control_dim());
  safety::Guard guard(model);
  std::vector<double> x(static_cast<std::size_t>(plant.state_dim()));
  std::vector<double> u(static_cast<std::size_t>(plant.control_dim()));
  std::printf("seed outcome controls state\n");
  std::array<int, 3> counts = {};
  for (int i = 0; i < options.episodes; ++i) {
    const std::uint64_t seed = options.seed + static_cast<std::uint64_t>(i);
    plant.Reset(seed);
    guard.Reset(seed);
    plant.Observe(x);
    int t = 0;
    for (; !plant.completed() && !plant.collided(); ++t) {
      policy.Control(t, x, u);
      if (guard.Filter(t, x, u, u).mode == control::Mode::kHalt) break;
      if (plant.Apply(u) != core::PlantStatus::kOk) break;
      plant.Observe(x);
    }
    const core::Outcome outcome = plant.collided()    ? core::Outcome::kCollided
                                  : plant.completed() ? core::Outcome::kCompleted
                                                      : core::Outcome::kHalted;
    ++counts[static_cast<std::size_t>(outcome)];
    std::printf("%llu %s %d", static_cast<unsigned long long>(seed), Name(outcome), t);
    for (const double entry : x) std::printf(" %.17g", entry);
    std::printf("\n");
  }
  std::fprintf(stderr, "%d completed, %d halted, %d collided\n", counts[0], counts[1], counts[2]);
}

}  // namespace dfr::apps::pusher
