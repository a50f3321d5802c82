#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "model.h"
#include "trial_runner.h"

namespace dfr::apps::pusher {

/// Progress of one method's recoveries: g_t divided by the threshold lambda_t |u| of the current
/// state, at most 1, averaged over recoveries. A recovery that has ended keeps its last value.
struct ConvergenceCurve {
  std::string method;
  std::vector<double> mean;            ///< Mean after 0, 1, ... applied controls.
  std::vector<double> standard_error;  ///< Standard error of each mean.
  int controls_per_iteration = 1;      ///< 2 for DFR: the probe and the step.
  int reached = 0;                     ///< Number of recoveries that reached the threshold.
};

/// Collects `recoveries` states in which the learned policy first meets the gate g_t <= lambda_t
/// |u|, and runs the recoveries of "dfr", "finite-difference" and "controller" from each. For
/// comparability, guided recovery climbs the paper's g instead of its support's g, and omits its
/// filter, which would prevent most recoveries.
/// @throws std::runtime_error if too few start states lead to the gate.
[[nodiscard]] std::vector<ConvergenceCurve> MeasureConvergence(PusherTrialRunner& runner,
                                                               int recoveries, std::uint64_t seed);

/// Mean over models of one method's curves, with the standard error between models. `reached` is
/// the sum over models. @throws std::invalid_argument if `curves` is empty.
[[nodiscard]] ConvergenceCurve MeanOverModels(const std::vector<ConvergenceCurve>& curves);

/// Levels of g_t that ascent reaches from the states of MeasureConvergence().
struct GateReach {
  int gates = 0;
  /// Number of gates at which g_t of some state reaches the threshold.
  int any_state = 0;
  /// Number of gates at which g_t reaches the threshold for some gripper position alone.
  int any_tip = 0;
  /// Mean of the largest g_t over gripper positions, divided by the threshold.
  double best_tip = 0.0;
};
/// Climbs g_t along its gradient, without arm and dynamics, from each state and from the
/// demonstrated state with the largest g_t. Uses the threshold of the state itself.
[[nodiscard]] GateReach MeasureReach(PusherTrialRunner& runner, int recoveries, std::uint64_t seed);

/// The paper's Fig. 5, collected as in the authors' scripts: the first `recoveries` recoveries of
/// episodes of "dfr" and of "finite-difference", from the start states that an experiment accepts.
/// An episode ends with its first recovery that does not reach the threshold. It therefore
/// contributes many successful recoveries and at most one failed recovery.
/// @throws std::runtime_error if too few start states lead to the gate.
[[nodiscard]] std::vector<ConvergenceCurve> MeasureEveryRecovery(PusherTrialRunner& runner,
                                                                 int recoveries,
                                                                 std::uint64_t seed);

}  // namespace dfr::apps::pusher
