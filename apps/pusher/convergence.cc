#include "convergence.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <stdexcept>
#include <utility>

#include "dfr/control/gradient_recovery.h"
#include "dfr/control/rollout.h"
#include "dfr/core/random.h"

namespace dfr::apps::pusher {
namespace {

constexpr int kMostControls = 1000;  // 500 iterations of two
constexpr int kMostStarts = 100'000;

// Where a recovery begins.
struct Gate {
  std::unique_ptr<core::SimulatedPlant> plant;
  int t = 0;
  double threshold = 0.0;
};

std::vector<Gate> FindGates(PusherTrialRunner& runner, int count, std::uint64_t seed) {
  const std::unique_ptr<core::SimulatedPlant> plant = runner.plant().Clone();
  const auto stopping = runner.model().MakeController(ParseMethod("early-stopping"));
  std::vector<Gate> gates;
  for (std::uint64_t i = 0; static_cast<int>(gates.size()) < count; ++i) {
    if (i == kMostStarts) {
      throw std::runtime_error("too few start states lead to a recovery: " +
                               std::to_string(gates.size()) + " of " + std::to_string(i));
    }
    const control::RolloutResult result =
        control::Rollout(*plant, *stopping, {.plant_seed = core::DeriveSeed(seed, {i})});
    if (result.halt_cause != control::HaltCause::kEarlyStopping) continue;
    gates.push_back({plant->Clone(), result.last_step.t, result.last_step.threshold});
  }
  return gates;
}

// Guided recovery's model of the paper's support: its features as they are.
control::GuidedModel PaperSupport(const Model& model) {
  const core::FeatureSelection selection(model.demonstrations().layout,
                                         model.task().published_features());
  const int n = selection.num_features();
  const core::FeatureTransform features(selection, Eigen::VectorXd::Zero(n),
                                        core::Matrix::Identity(n, n));
  // Its gate stays shut: the curves end at the paper's threshold.
  return {features, *model.task().published(), model.demonstrations().trajectories,
          control::GuidedModelOptions{.gate_quantile = 1.0}};
}

// g_t / threshold after each control, until the learned policy may go on or the recovery gives up.
std::vector<double> Climb(const Model& model, const Gate& gate, core::SimulatedPlant& plant,
                          control::Controller& controller, std::uint64_t seed) {
  controller.Reset(seed);
  std::vector<double> x(static_cast<std::size_t>(plant.state_dim()));
  std::vector<double> u(static_cast<std::size_t>(plant.control_dim()));
  std::vector<double> curve;
  while (true) {
    plant.Observe(x);
    curve.push_back(std::min(1.0, model.task().support().Decision(gate.t, x) / gate.threshold));
    if (curve.back() >= 1.0 || curve.size() > kMostControls) return curve;
    const control::Mode mode = controller.Next(x, u).mode;
    if (mode == control::Mode::kHalt || mode == control::Mode::kPolicy) return curve;
    if (plant.Apply(u) != core::PlantStatus::kOk) return curve;
  }
}

}  // namespace

std::vector<ConvergenceCurve> MeasureConvergence(PusherTrialRunner& runner, int recoveries,
                                                 std::uint64_t seed) {
  const Model& model = runner.model();
  const std::vector<Gate> gates = FindGates(runner, recoveries, seed);
  const control::GuidedModel paper_support = PaperSupport(model);
  std::vector<ConvergenceCurve> curves;
  for (const std::string name : {"dfr", "finite-difference", "guided"}) {
    ConvergenceCurve curve;
    curve.method = name;
    curve.controls_per_iteration = name == "dfr" ? 2 : 1;
    std::vector<double> sum(kMostControls + 1, 0.0);
    std::vector<double> square(sum);
    for (std::size_t i = 0; i < gates.size(); ++i) {
      const Gate& gate = gates[i];
      const std::unique_ptr<core::SimulatedPlant> plant = gate.plant->Clone();
      const std::unique_ptr<control::Controller> controller =
          name == "guided" ? model.task().MakeController(
                                 std::make_unique<control::GradientRecovery>(paper_support),
                                 model.policy(), {.first_step = gate.t})
                           : model.MakeController(ParseMethod(name), plant.get(), gate.t);
      std::vector<double> climb =
          Climb(model, gate, *plant, *controller, core::DeriveSeed(seed, {i, 1}));
      curve.reached += climb.back() >= 1.0 ? 1 : 0;
      climb.resize(sum.size(), climb.back());
      for (std::size_t k = 0; k < sum.size(); ++k) {
        sum[k] += climb[k];
        square[k] += climb[k] * climb[k];
      }
    }
    const auto n = static_cast<double>(gates.size());
    for (std::size_t k = 0; k < sum.size(); ++k) {
      const double mean = sum[k] / n;
      curve.mean.push_back(mean);
      curve.standard_error.push_back(
          std::sqrt(std::max(0.0, square[k] / n - mean * mean) / std::max(1.0, n - 1.0)));
    }
    curves.push_back(std::move(curve));
  }
  return curves;
}

}  // namespace dfr::apps::pusher
