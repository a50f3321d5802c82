#include "convergence/convergence.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <span>
#include <stdexcept>
#include <utility>

#include "dfr/control/published/gradient_recovery.h"
#include "dfr/control/rollout.h"
#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "dfr/experiment/intervals.h"

namespace dfr::apps::pusher {
namespace {

constexpr int kMostControls = 1000;  // 500 iterations of two controls
constexpr int kMostStarts = 100'000;

// State in which a recovery begins.
struct Gate {
  std::unique_ptr<core::SimulatedPlant> plant;
  int t = 0;
};

std::vector<Gate> FindGates(PusherTrialRunner& runner, int count, std::uint64_t seed) {
  const std::unique_ptr<core::SimulatedPlant> plant = runner.plant().Clone();
  const auto stopping = runner.model().MakeController(study::ParseMethod("early-stopping"));
  std::vector<Gate> gates;
  for (std::uint64_t i = 0; static_cast<int>(gates.size()) < count; ++i) {
    if (i == kMostStarts) {
      throw std::runtime_error("too few start states lead to a recovery: " +
                               std::to_string(gates.size()) + " of " + std::to_string(i));
    }
    const control::RolloutResult result =
        control::Rollout(*plant, *stopping, {.plant_seed = core::DeriveSeed(seed, {i})});
    if (result.halt_cause != control::HaltCause::kEarlyStopping) continue;
    gates.push_back({plant->Clone(), result.last_step.t});
  }
  return gates;
}

// Guided recovery's model on the paper's support, with unscaled features.
struct PaperTask {
  explicit PaperTask(const Model& model)
      : features(core::FeatureTransform::Identity(core::FeatureSelection(
            model.demonstrations().layout, model.task().published_features()))),
        support(*model.task().published()),
        seen(features, model.demonstrations().trajectories),
        // This quantile keeps the gate closed: the curves end at the paper's threshold instead.
        levels(support, seen.points, {.gate_quantile = 1.0}),
        response(seen) {}
  [[nodiscard]] control::TaskView view() const { return {features, support, levels, response}; }

  core::FeatureTransform features;
  const core::LogDecisionFunction& support;
  control::FeatureTrajectories seen;
  control::Levels levels;
  control::Response response;
};

// lambda_t |u| of the learned control in state x.
double Threshold(const Model& model, int t, std::span<const double> x, std::span<double> u) {
  model.policy().Control(t, x, u);
  const std::vector<double>& lambda = model.task().lambda();
  return lambda[std::min(static_cast<std::size_t>(t), lambda.size() - 1)] *
         core::AsVector(u).norm();
}

// g_t divided by Algorithm 1's threshold in state x, at most 1.
double Share(const Model& model, int t, std::span<const double> x, std::span<double> u) {
  return std::min(1.0, model.task().support().Decision(t, x) / Threshold(model, t, x, u));
}

// Level of g_t that ascent from x reaches if only entries begin ... end - 1 change.
double Climbed(const core::DecisionFunction& g, int t, std::vector<double> x, std::size_t begin,
               std::size_t end) {
  constexpr double kFirstStep = 0.05;  // m
  constexpr double kLastStep = 1e-5;
  std::vector<double> gradient(x.size());
  std::vector<double> there(x);
  double level = g.Gradient(t, x, gradient);
  for (double step = kFirstStep; step > kLastStep;) {
    const double norm = core::AsVector(std::span(gradient).subspan(begin, end - begin)).norm();
    if (!(norm > 0.0)) break;
    there = x;
    for (std::size_t i = begin; i < end; ++i) there[i] += step * gradient[i] / norm;
    if (g.Decision(t, there) > level) {
      x = there;
      level = g.Gradient(t, x, gradient);
    } else {
      step *= 0.5;
    }
  }
  return level;
}

// Returns Share() at the start and after each control, until the learned policy may continue or the
// recovery ends.
std::vector<double> Climb(const Model& model, const Gate& gate, core::SimulatedPlant& plant,
                          control::Controller& controller, std::uint64_t seed) {
  controller.Reset(seed);
  std::vector<double> x(static_cast<std::size_t>(plant.state_dim()));
  std::vector<double> u(static_cast<std::size_t>(plant.control_dim()));
  std::vector<double> curve;
  while (true) {
    plant.Observe(x);
    curve.push_back(Share(model, gate.t, x, u));
    if (curve.back() >= 1.0 || curve.size() > kMostControls) return curve;
    const control::Mode mode = controller.Next(x, u).mode;
    if (mode == control::Mode::kHalt || mode == control::Mode::kPolicy) return curve;
    if (plant.Apply(u) != core::PlantStatus::kOk) return curve;
  }
}

// Collects the curves of all recoveries in the rollouts that it observes.
class RecoveryCurves final : public control::RolloutObserver {
 public:
  RecoveryCurves(const Model& model, int control_dim)
      : model_(&model), u_(static_cast<std::size_t>(control_dim)) {}

  void OnControl(const control::RolloutEvent& event) override {
    if (event.step.mode == control::Mode::kPolicy) {
      recovering_ = false;
      return;
    }
    if (!recovering_) curves_.push_back({Share(*model_, event.step.t, event.x, u_)});
    recovering_ = true;
    curves_.back().push_back(Share(*model_, event.step.t, event.next_x, u_));
  }
  void OnEnd(const control::RolloutResult& /*result*/) override { recovering_ = false; }

  [[nodiscard]] std::vector<std::vector<double>>& curves() noexcept { return curves_; }

 private:
  const Model* model_;
  std::vector<double> u_;
  std::vector<std::vector<double>> curves_;
  bool recovering_ = false;
};

ConvergenceCurve Average(const std::string& method,
                         const std::vector<std::vector<double>>& climbs) {
  experiment::MeanCurve average = experiment::AverageCurves(climbs, kMostControls + 1);
  ConvergenceCurve curve;
  curve.method = method;
  curve.mean = std::move(average.mean);
  curve.standard_error = std::move(average.standard_error);
  curve.controls_per_iteration = method == "dfr" ? 2 : 1;
  for (const std::vector<double>& climb : climbs) curve.reached += climb.back() >= 1.0 ? 1 : 0;
  return curve;
}

}  // namespace

std::vector<ConvergenceCurve> MeasureConvergence(PusherTrialRunner& runner, int recoveries,
                                                 std::uint64_t seed) {
  const Model& model = runner.model();
  const std::vector<Gate> gates = FindGates(runner, recoveries, seed);
  const PaperTask paper(model);
  std::vector<ConvergenceCurve> curves;
  for (const std::string name : {"dfr", "finite-difference", "controller"}) {
    std::vector<std::vector<double>> climbs;
    climbs.reserve(gates.size());
    for (std::size_t i = 0; i < gates.size(); ++i) {
      const Gate& gate = gates[i];
      const std::unique_ptr<core::SimulatedPlant> plant = gate.plant->Clone();
      const std::unique_ptr<control::Controller> controller =
          name == "controller"
              ? model.task().MakeController(
                    std::make_unique<control::GradientRecovery>(paper.view()), model.policy(),
                    {.first_step = gate.t})
              : model.MakeController(study::ParseMethod(name), plant.get(), gate.t);
      climbs.push_back(Climb(model, gate, *plant, *controller, core::DeriveSeed(seed, {i, 1})));
    }
    curves.push_back(Average(name, climbs));
  }
  return curves;
}

ConvergenceCurve MeanOverModels(const std::vector<ConvergenceCurve>& curves) {
  DFR_THROW_UNLESS(!curves.empty(), "there are no curves");
  ConvergenceCurve mean = curves.front();
  mean.reached = 0;
  std::vector<std::vector<double>> means;
  for (const ConvergenceCurve& curve : curves) {
    mean.reached += curve.reached;
    means.push_back(curve.mean);
  }
  experiment::MeanCurve average = experiment::AverageCurves(means, mean.mean.size());
  mean.mean = std::move(average.mean);
  mean.standard_error = std::move(average.standard_error);
  return mean;
}

GateReach MeasureReach(PusherTrialRunner& runner, int recoveries, std::uint64_t seed) {
  const Model& model = runner.model();
  const core::DecisionFunction& g = model.task().support();
  std::size_t tip = 0;
  for (const core::StateLayout::Block& block : runner.plant().layout().blocks) {
    if (block.name == "tip") tip = static_cast<std::size_t>(block.offset);
  }
  constexpr std::size_t kTipEntries = 3;
  GateReach reach;
  std::vector<double> x(static_cast<std::size_t>(runner.plant().state_dim()));
  std::vector<double> u(static_cast<std::size_t>(runner.plant().control_dim()));
  for (const Gate& gate : FindGates(runner, recoveries, seed)) {
    gate.plant->Observe(x);
    const double threshold = Threshold(model, gate.t, x, u);
    // The demonstrated state with the largest g, and x with the demonstrated gripper position that
    // gives the largest g.
    std::vector<double> highest(x);
    std::vector<double> moved(x);
    for (const core::Trajectory& d : model.demonstrations().trajectories) {
      const std::span<const double> state = core::Row(d.states, std::min(gate.t, d.num_steps()));
      if (g.Decision(gate.t, state) > g.Decision(gate.t, highest)) {
        highest.assign(state.begin(), state.end());
      }
      std::vector<double> other(x);
      for (std::size_t i = tip; i < tip + kTipEntries; ++i) other[i] = state[i];
      if (g.Decision(gate.t, other) > g.Decision(gate.t, moved)) moved = other;
    }
    const double best_tip = std::max(Climbed(g, gate.t, x, tip, tip + kTipEntries),
                                     Climbed(g, gate.t, moved, tip, tip + kTipEntries));
    ++reach.gates;
    reach.any_state += Climbed(g, gate.t, highest, 0, x.size()) >= threshold ? 1 : 0;
    reach.any_tip += best_tip >= threshold ? 1 : 0;
    reach.best_tip += std::min(1.0, best_tip / threshold);
  }
  reach.best_tip /= std::max(1, reach.gates);
  return reach;
}

std::vector<ConvergenceCurve> MeasureEveryRecovery(PusherTrialRunner& runner, int recoveries,
                                                   std::uint64_t seed) {
  const Model& model = runner.model();
  const auto most = static_cast<std::size_t>(recoveries);
  std::vector<ConvergenceCurve> curves;
  for (const std::string name : {"dfr", "finite-difference"}) {
    const std::unique_ptr<core::SimulatedPlant> plant = runner.plant().Clone();
    const auto controller = model.MakeController(study::ParseMethod(name), plant.get());
    RecoveryCurves climbs(model, plant->control_dim());
    for (std::uint64_t i = 0; climbs.curves().size() < most; ++i) {
      if (i == kMostStarts) {
        throw std::runtime_error(
            "too few start states lead to a recovery: " + std::to_string(climbs.curves().size()) +
            " of " + std::to_string(i));
      }
      const std::uint64_t start = core::DeriveSeed(seed, {i});
      if (!runner.Accepts(start)) continue;
      static_cast<void>(control::Rollout(
          *plant, *controller,
          {.plant_seed = start, .controller_seed = core::DeriveSeed(seed, {i, 1})}, &climbs));
    }
    climbs.curves().resize(most);
    curves.push_back(Average(name, climbs.curves()));
  }
  return curves;
}

}  // namespace dfr::apps::pusher
