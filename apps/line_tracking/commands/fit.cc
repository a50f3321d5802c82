#include <iostream>

#include "apps/inputs.h"
#include "commands/commands.h"
#include "dfr/core/features/features.h"
#include "dfr/core/text/format.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/line_task/line_task.h"

namespace dfr::apps::line_tracking {

core::StateLayout LayoutWith(const std::string& features) {
  SceneOptions uncalibrated;
  uncalibrated.calibration = kNoCalibration;
  const line_task::LineTask task(LoadCalibration(uncalibrated),
                                 sim::LineTrackingPlant::p_world_base());
  core::FeatureSelection(task.layout(), features);
  return task.layout();
}

void RunFit(const FitOptions& options) {
  const core::StateLayout layout = LayoutWith(options.model.support_features);
  MustExist(options.demonstrations,
            "Run `line_tracking demonstrate` first, or give another file with --demonstrations");
  const imitation::DemonstrationSet set = imitation::LoadRobomimic(options.demonstrations);
  MustBeOfTask(options.demonstrations, {set.layout, set.control_dim},
               {layout, ProportionalPolicy().control_dim()}, "line_tracking demonstrate");
  if (!set.note.empty()) std::cout << core::Printable(set.note) << '\n';
  kernel::Selection selection;
  const LineModel model = LineModel::Fit(set, options.model, &selection);
  model.Save(options.out);
  if (!selection.rows.empty()) std::cout << selection.Table();
  std::cout << options.out.string() << ": policy, " << model.task().support().num_steps()
            << " supports and lambda from " << set.trajectories.size() << " demonstrations\n";
}

}  // namespace dfr::apps::line_tracking
