#include <algorithm>
#include <cstdio>

#include "apps/inputs.h"
#include "commands.h"
#include "dfr/core/text/format.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/sim/pusher/pusher_plant.h"
#include "model.h"

namespace dfr::apps::pusher {

void RunFit(const FitOptions& options) {
  ModelOptions model_options = options.model;
  model_options.learner = Learner::Parse(options.learner);
  const sim::PusherPlant plant;
  MustExist(options.demonstrations,
            "Run `pusher demonstrate` first, or give another file with --demonstrations");
  const imitation::DemonstrationSet set = imitation::LoadRobomimic(options.demonstrations);
  MustBeOfTask(options.demonstrations, {set.layout, set.control_dim},
               {plant.layout(), plant.control_dim()}, "pusher demonstrate");
  if (!set.note.empty()) std::printf("%s\n", core::Printable(set.note).c_str());
  const int use = options.use > 0 ? options.use : static_cast<int>(set.trajectories.size());
  const Model model = Model::Fit(set, use, model_options);
  model.Save(options.out);

  // Prints the share of demonstrated states outside the support, as a check of the fit.
  int states = 0;
  int outside = 0;
  for (int i = 0; i < use; ++i) {
    const core::Trajectory& trajectory = set.trajectories[static_cast<std::size_t>(i)];
    for (Eigen::Index t = 0; t < trajectory.states.rows(); ++t) {
      ++states;
      const double g =
          model.task().support().Decision(static_cast<int>(t), core::Row(trajectory.states, t));
      if (g < 0.0) ++outside;
    }
  }
  const auto [low, high] =
      std::minmax_element(model.task().lambda().begin(), model.task().lambda().end());
  std::printf("%s: policy %s, support of %d time steps, lambda_t in [%.3g, %.3g]\n",
              options.out.c_str(), model_options.learner.Name().c_str(),
              model.task().support().num_steps(), *low, *high);
  std::printf(
      "of the %d demonstrated states %.1f %% are outside; nu = %g bounds the share at each "
      "time step, where demonstrations that have ended keep their last state\n",
      states, 100.0 * outside / states, model_options.nu);
}

}  // namespace dfr::apps::pusher
