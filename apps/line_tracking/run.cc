#include <cstdio>
#include <iostream>
#include <stdexcept>
#include <utility>

#include "commands.h"
#include "dfr/core/random.h"
#include "film.h"
#include "site.h"

namespace dfr::apps {

void RunRun(const RunOptions& options) {
  if (options.episodes < 1) throw std::invalid_argument("--episodes must be positive");
  LineModel model = LineModel::Load(options.model);
  LineSite site(std::move(model), {options.method}, options.scene.plant,
                LoadCalibration(options.scene));
  std::array<int, 3> counts{};
  std::cout << "episode  outcome    cause               controls  recovery  tracked [mm]\n";
  for (int i = 0; i < options.episodes; ++i) {
    const auto episode = static_cast<std::uint64_t>(i);
    const experiment::EpisodeResult result =
        site.Run(0, core::DeriveSeed(options.seed, {0, episode}),
                 core::DeriveSeed(options.seed, {1, episode}));
    ++counts[static_cast<std::size_t>(result.outcome)];
    std::printf("%7d  %-9s  %-18s  %8d  %8d  %12.1f\n", i, core::Name(result.outcome),
                result.cause.c_str(), result.controls, result.recovery_controls,
                1e3 * site.plant().truth().progress_m);
    std::fflush(stdout);
  }
  std::cout << options.method << ": " << counts[0] << " completed, " << counts[1] << " halted, "
            << counts[2] << " collided\n";
}

void RunRender(const RenderOptions& options) {
  LineModel model = LineModel::Load(options.model);
  LineSite site(std::move(model), {options.method}, options.scene.plant,
                LoadCalibration(options.scene));
  const control::RolloutResult result =
      RecordEpisode(site, 0, options.method, options.seed, options.seed, options.out);
  std::cout << options.out.string() << ": " << core::Name(result.outcome) << " after "
            << result.controls() << " controls\n";
}

}  // namespace dfr::apps
