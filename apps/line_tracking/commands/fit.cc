#include <iostream>

#include "commands/commands.h"
#include "dfr/core/text/format.h"
#include "dfr/imitation/demonstrations.h"

namespace dfr::apps::line_tracking {

void RunFit(const FitOptions& options) {
  const imitation::DemonstrationSet set = imitation::LoadRobomimic(options.demonstrations);
  if (!set.note.empty()) std::cout << core::Printable(set.note) << '\n';
  kernel::Selection selection;
  const LineModel model = LineModel::Fit(set, options.model, &selection);
  model.Save(options.out);
  if (!selection.rows.empty()) std::cout << selection.Table();
  std::cout << options.out.string() << ": policy, " << model.task().support().num_steps()
            << " supports and lambda from " << set.trajectories.size() << " demonstrations\n";
}

}  // namespace dfr::apps::line_tracking
