#include <cstdio>
#include <string>
#include <vector>

#include "commands.h"
#include "dfr/core/random.h"
#include "trial_runner.h"

namespace dfr::apps::pusher {

void RunRender(const RenderOptions& options) {
  std::vector<safety::Method> methods;
  for (const std::string& name : options.methods) {
    methods.push_back(study::ParseMethod(name, study::kLoadedMethods));
  }
  PusherTrialRunner runner(Model::Load(options.model), methods, options.plant, {});
  const std::vector<RolloutVideo> videos =
      RecordRollouts(runner, options.methods, options.seed, core::DeriveSeed(options.seed, {1}),
                     options.width, options.height);
  const std::string ending = options.out.extension();
  if (ending == ".png" || ending == ".jpg") {
    WriteStill(options.out, videos, SIZE_MAX);
  } else {
    WriteVideo(options.out, videos);
  }
  for (const RolloutVideo& video : videos) {
    const bool halted = video.result.outcome == core::Outcome::kHalted;
    std::printf("%-16s %s%s%s after %d controls, %d of them recovery\n", video.title.c_str(),
                core::Name(video.result.outcome), halted ? ": " : "",
                halted ? control::Name(video.result.halt_cause) : "", video.result.controls(),
                video.result.recovery_controls());
  }
  std::printf("%s\n", options.out.c_str());
}

}  // namespace dfr::apps::pusher
