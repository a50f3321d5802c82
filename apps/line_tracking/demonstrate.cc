#include <iomanip>
#include <iostream>

#include "commands.h"
#include "dfr/experiment/progress.h"
#include "dfr/imitation/demonstrations.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {

void RunDemonstrate(const DemonstrateOptions& options) {
  experiment::ProgressBar bar("demonstrations");
  imitation::DemonstrationSet set = Demonstrate(
      options.scene.plant, LoadCalibration(options.scene), options.count, options.steps,
      options.seed, [&bar](const experiment::Progress& progress) { bar.Show(progress); });
  set.provenance.date = core::Today();
  imitation::SaveRobomimic(set, options.out);
  double farthest = 0.0;
  for (const core::Trajectory& trajectory : set.trajectories) {
    farthest = std::max(farthest, trajectory.states.col(2).cwiseAbs().maxCoeff());
  }
  std::cout << std::fixed << std::setprecision(2) << options.out.string() << ": "
            << set.trajectories.size() << " open-loop demonstrations of " << options.steps
            << " controls, " << set.discarded << " discarded; at most " << farthest
            << " mm from the line\n";
}

}  // namespace dfr::apps::line_tracking
