#include <cstdio>

#include "commands.h"
#include "dfr/experiment/progress.h"
#include "dfr/imitation/demonstrations.h"
#include "supervisor/supervisor.h"

namespace dfr::apps::pusher {

void RunDemonstrate(const DemonstrateOptions& options) {
  const auto supervisor = options.supervisor.empty()
                              ? imitation::GaussianPolicy::Load(ShippedSupervisor())
                              : LoadSupervisor(options.supervisor);
  sim::PusherPlant plant(options.plant);
  experiment::ProgressBar bar("demonstrate");
  experiment::ProgressMeter meter(options.count,
                                  [&](const experiment::Progress& p) { bar.Show(p); });
  DemonstrationCounts counts;
  const imitation::DemonstrationSet set =
      Demonstrate(plant, supervisor, options.count, options.horizon, options.seed, &counts,
                  [&](int) { meter.Advance(); });
  imitation::SaveRobomimic(set, options.out);
  std::printf("%s: %d demonstrations; discarded: %d with a violation, %d over the time limit\n",
              options.out.c_str(), counts.kept, counts.collided, counts.incomplete);
}

}  // namespace dfr::apps::pusher
