#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "model.h"
#include "trial_runner.h"

namespace dfr::apps::pusher {

/// How fast one method's recoveries climb: g_t over the threshold lambda_t |u| of the state that it
/// has come to, at most 1, averaged over recoveries; one that has ended keeps its last value.
struct ConvergenceCurve {
  std::string method;
  std::vector<double> mean;            ///< By applied controls, from 0.
  std::vector<double> standard_error;  ///< Standard error of each mean.
  int controls_per_iteration = 1;      ///< 2 for DFR: the probe and the step.
  int reached = 0;                     ///< Recoveries that reached the threshold.
};

/// `recoveries` states in which the learned policy first meets the gate g_t <= lambda_t |u|, and
/// the recoveries of "dfr", "finite-difference" and "guided" from each of them. To be comparable,
/// guided recovery climbs the paper's g here instead of its own support, and does without its
/// filter, which would end most recoveries before they begin.
/// @throws std::runtime_error if too few start states lead to the gate.
[[nodiscard]] std::vector<ConvergenceCurve> MeasureConvergence(PusherTrialRunner& runner,
                                                               int recoveries, std::uint64_t seed);

/// How high g_t can be raised from the states of MeasureConvergence().
struct GateReach {
  int gates = 0;
  int any_state = 0;      ///< Some state has g_t >= the threshold there,
  int any_tip = 0;        ///< some place of the gripper, all else as it is.
  double best_tip = 0.0;  ///< The largest g_t of any place of the gripper over it, mean.
};
/// Climbs g_t by its own gradient, without arm and dynamics, from the state itself and from that
/// demonstrated one that is highest. Thresholds are those of the state.
[[nodiscard]] GateReach MeasureReach(PusherTrialRunner& runner, int recoveries, std::uint64_t seed);

/// The paper's Fig. 5 as its authors' scripts collect it: the first `recoveries` recoveries of
/// episodes of "dfr" and of "finite-difference", from the start states that an experiment accepts.
/// An episode goes on after a recovery that reaches the threshold and ends with one that does not,
/// so that it counts many of the former and at most one of the latter.
/// @throws std::runtime_error if too few start states lead to the gate.
[[nodiscard]] std::vector<ConvergenceCurve> MeasureEveryRecovery(PusherTrialRunner& runner,
                                                                 int recoveries,
                                                                 std::uint64_t seed);

}  // namespace dfr::apps::pusher
