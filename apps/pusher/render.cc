#include <cstdio>
#include <string>
#include <vector>

#include "apps/window_observer.h"
#include "commands.h"
#include "dfr/core/random.h"
#include "dfr/sim/pusher/pusher_view.h"
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

void RunView(const ViewOptions& options) {
  const safety::Method method = study::ParseMethod(options.method, study::kLoadedMethods);
  PusherTrialRunner runner(Model::Load(options.model), {method}, options.plant, {});
  sim::PusherWindow window(runner.plant(), "pusher: " + options.method);
  bool open = true;
  for (std::uint64_t episode = 0; open; ++episode) {
    const std::uint64_t seed = options.seed + episode;
    const std::string title = options.method + ", start state " + std::to_string(seed);
    WindowObserver observer([&](const std::string& text, double seconds) {
      return window.Show(runner.plant(), title, text, seconds);
    });
    runner.RunObserved(0, seed, core::DeriveSeed(seed, {1}), &observer);
    open = observer.open();
  }
}

}  // namespace dfr::apps::pusher
