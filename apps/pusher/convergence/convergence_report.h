#pragma once

#include <string_view>

#include "commands.h"
#include "dfr/experiment/paired_evaluation.h"
#include "dfr/experiment/report.h"
#include "trial_runner.h"

namespace dfr::apps::pusher {

/// Preset that measures the recoveries of every model, for each trial and number of demonstrations.
inline constexpr std::string_view kFig5 = "fig5";

/// Measures the speed of the first learner's recoveries, prints the figures, and adds them to the
/// report. Without the preset kFig5, measures only the first trial's last model.
/// @throws std::runtime_error as MeasureConvergence() does.
void MeasureRecoveries(const ExperimentOptions& options, const experiment::EvaluationPlan& plan,
                       TrialRunnerFactory& factory, experiment::ReportOptions& report);

}  // namespace dfr::apps::pusher
