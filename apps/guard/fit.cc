#include <algorithm>
#include <cstdio>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "apps/inputs.h"
#include "apps/usage_error.h"
#include "commands.h"
#include "dfr/core/features/absolute_actions.h"
#include "dfr/core/text/format.h"
#include "dfr/experiment/progress.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/reduction/state_reduction.h"

namespace dfr::apps::guard {

void Describe(const safety::GuardModel& model) {
  const safety::GuardSummary& summary = model.summary();
  const safety::GuardSettings& settings = model.settings();
  const control::Levels& levels = model.task().levels();
  const std::string& spec = model.task().features().selection().spec();
  const auto [low, high] = std::minmax_element(model.lambda().begin(), model.lambda().end());
  Print("demonstrations  %d with %d actions, from %s\n", summary.demonstrations,
        summary.transitions, summary.source.c_str());
  const core::FeatureSelection& selection = model.task().features().selection();
  const auto circles = static_cast<int>(selection.map().circles().size());
  const int features = selection.num_features() - circles;
  if (model.reduction() == nullptr) {
    Print("features        %s: %d of %d entries of a state%s\n",
          spec.empty() ? "the whole state" : spec.c_str(), features, model.state_dim(),
          circles > 0 ? ", angles by cosine and sine" : "");
  } else {
    Print("features        %s: %d of the %d entries of a state\n", spec.c_str(), features,
          model.state_dim());
    if (const auto novel = model.reduction()->novel_left_out()) {
      Print(
          "                of left-out demonstrations, %.1f %% have a picture unlike all others\n",
          100.0 * *novel);
    }
  }
  for (const reduction::ComponentsScore& row : summary.components) {
    Print(
        "components      %3d: of left-out demonstrations, actions explained %5.1f %%, states "
        "inside "
        "%5.1f %%, error of the predicted change %5.1f %%\n",
        row.components, 100.0 * row.explained, 100.0 * row.inside, 100.0 * row.response_error);
  }
  if (!summary.components_reason.empty()) {
    Print("                %s\n", summary.components_reason.c_str());
  }
  Print("support         %d time steps, nu %g, gamma %g (whitened); support fits: %d\n",
        model.num_steps(), summary.nu, summary.gamma, summary.support_fits);
  Print(
      "                %.1f %% of the states of left-out demonstrations are inside; "
      "%.1f %% of these demonstrations never leave\n",
      100.0 * summary.acceptance, 100.0 * summary.inside_throughout);
  Print(
      "                the guard would change %.1f %% of their actions, and predicts %.1f %% to "
      "end outside; "
      "nearby demonstrations explain %.1f %% of their variance, with an error of %.1f %%\n",
      100.0 * summary.changed, 100.0 * summary.ends_outside, 100.0 * summary.explained,
      100.0 * summary.action_error);
  Print(
      "gap test        %d points halfway between groups of demonstrations, in %d time steps; "
      "%d of these points are inside\n",
      summary.gaps.points, summary.gaps.steps, summary.gaps.inside);
  Print("levels of l     the policy's action passes at %.3g (first step); slack %.3g\n",
        levels.pass(0), levels.slack());
  Print(
      "alarm           at l < %.3g: a further demonstration raises one with probability %.3g "
      "at most, %s\n",
      -settings.alarm_level, summary.false_alarms, safety::DescribeGuarantee(summary).c_str());
  Print("lambda_t        %.3g to %.3g, the change of g per unit of action\n", *low, *high);
  Print(
      "actions         %d entries, within +-%s; halts after %d of the policy's, or %d "
      "of any kind\n",
      model.action_dim(), safety::Join(settings.action_limit).c_str(), settings.horizon,
      settings.max_actions);
  Print("strategy        %s\n", safety::Name(settings.strategy));
  if (settings.direction_error > 0.0) {
    Print(
        "certificate     eps %.3g (%.3g in demonstrations), K %.3g: whitened features per unit of "
        "action\n"
        "                with %.0f %% confidence %.1f %% of further demonstrations stay below%s\n",
        settings.direction_error, summary.direction_error.value, summary.gain.value,
        100.0 * summary.direction_error.confidence, 100.0 * summary.direction_error.coverage,
        summary.held_out > 0 ? "" : ", approximately");
  }
  for (const safety::Clearance& clearance : safety::Clearances(model)) {
    Print(
        "clearance       %s: where no alarm is raised a demonstrated state is within %.3g in it "
        "(step %d; median %.3g)\n",
        clearance.block.c_str(), clearance.largest, clearance.step, clearance.median);
  }
}

std::shared_ptr<const safety::GuardModel> LoadGuard(const std::filesystem::path& file) {
  MustExist(file, "Run `guard fit` first, or name another file");
  return safety::GuardModel::Load(file);
}

void Describe(const std::vector<std::string>& warnings) {
  for (const std::string& warning : warnings) Print("warning         %s\n", warning.c_str());
}

namespace {

// Checks --action-limit before the episodes are read.
void CheckActionLimit(const std::vector<double>& limit, int dim) {
  if (limit.size() > 1 && limit.size() != static_cast<std::size_t>(dim)) {
    throw UsageError(core::Format(
        "--action-limit: has %zu entries, but actions have %d: give one entry for all, or %d",
        limit.size(), dim, dim));
  }
  if (!limit.empty() && *std::max_element(limit.begin(), limit.end()) == 0.0) {
    throw UsageError("--action-limit: is zero in all entries: nothing could move");
  }
}

// Opens the demonstrations with the pictures that `features` name.
std::unique_ptr<imitation::DemonstrationReader> OpenFor(const std::string& features,
                                                        const FitOptions& options) {
  try {
    return imitation::OpenDemonstrations(options.demonstrations, options.filter_key,
                                         reduction::StateReduction::Requests(features));
  } catch (const imitation::RequestError& e) {
    throw UsageError(std::string("--features: ") + e.what());
  }
}

}  // namespace

bool RunFit(const FitOptions& options) {
  safety::GuardOptions guard = options.guard;
  guard.strategy = safety::ParseStrategy(options.strategy);
  guard.features = core::StripObservationPrefixes(guard.features);
  const auto reader = OpenFor(guard.features, options);
  ValueOf("--features",
          [&] { reduction::StateReduction::CheckFeatures(reader->layout(), guard.features); });
  CheckActionLimit(guard.action_limit, reader->control_dim());
  if (!reader->note().empty()) Print("%s\n", reader->note().c_str());
  std::vector<core::Trajectory> all;
  std::vector<core::Trajectory> completed;
  for (int i = 0; i < reader->num_episodes(); ++i) {
    all.push_back(reader->Read(i));
    if (all.back().outcome == core::Outcome::kCompleted) completed.push_back(all.back());
  }
  // If no episode is recorded as completed, all are used.
  const bool choose = !options.all && !completed.empty() && completed.size() < all.size();
  if (choose) {
    Print("%zu episodes did not complete the task and are left out (--all takes them)\n",
          all.size() - completed.size());
  }

  if (!options.all && completed.empty()) {
    Print(
        "none of %zu episodes is recorded as completed. The guard learns from all of them: if they "
        "failed, use others (--all omits this note)\n",
        all.size());
  }

  const auto absolute = core::FindAbsoluteActions(choose ? completed : all);
  if (!absolute.empty() && !options.as_recorded) {
    throw std::runtime_error(
        options.demonstrations.string() + ": " + core::Describe(absolute, reader->layout()) +
        ". A guard needs velocities or increments, for which zero means no motion: make them with "
        "guard convert --differences, or give --as-recorded if the actions are increments already");
  }

  guard.source = options.demonstrations.filename().string();
  experiment::ProgressBar bar("fit");
  experiment::ProgressMeter meter(
      1000, [&](const experiment::Progress& progress) { bar.Show(progress); });
  int done = 0;
  guard.progress = [&](std::string_view stage, double share) {
    const int now = static_cast<int>(1000.0 * share);
    meter.Advance(now - done, std::string(stage));
    done = now;
    return true;
  };
  const std::vector<core::Trajectory>& chosen = choose ? completed : all;
  const auto model = safety::GuardModel::Fit(reader->layout(), chosen, guard);
  model->Save(options.out);
  const std::vector<std::string> warnings = safety::Warnings(*model);
  Describe(*model);
  Describe(warnings);
  Print("%s\n", options.out.c_str());
  return !options.strict || warnings.empty();
}

}  // namespace dfr::apps::guard
