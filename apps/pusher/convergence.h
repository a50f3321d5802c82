#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "model.h"
#include "trial_runner.h"

namespace dfr::apps::pusher {

/// How fast one method's recoveries climb: g_t over the threshold that it has to reach, at most 1,
/// averaged over recoveries; one that has ended keeps its last value.
struct ConvergenceCurve {
  std::string method;
  std::vector<double> mean;            ///< By applied controls, from 0.
  std::vector<double> standard_error;  ///< Of the mean.
  int controls_per_iteration = 1;      ///< 2 for DFR: the probe and the step.
  int reached = 0;                     ///< Recoveries that reached the threshold.
};

/// The paper's Fig. 5: `recoveries` states in which the learned policy first meets the gate g_t <=
/// lambda_t |u|, and the recoveries of "dfr", "finite-difference" and "guided" from each of them,
/// to that threshold. To be comparable, guided recovery climbs the paper's g here instead of its
/// own support, and does without its filter, which would end most recoveries before they begin.
/// @throws std::runtime_error if too few start states lead to the gate.
[[nodiscard]] std::vector<ConvergenceCurve> MeasureConvergence(PusherTrialRunner& runner,
                                                               int recoveries, std::uint64_t seed);

}  // namespace dfr::apps::pusher
