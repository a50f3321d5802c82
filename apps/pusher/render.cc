#include <cstdio>
#include <stdexcept>
#include <string>
#include <vector>

#include "commands.h"
#include "dfr/core/format.h"
#include "dfr/core/random.h"
#include "dfr/sim/pusher/pusher_view.h"
#include "trial_runner.h"

namespace dfr::apps::pusher {

void Save(const std::vector<RolloutVideo>& videos, const std::filesystem::path& path) {
  const std::string ending = path.extension();
  if (ending == ".png" || ending == ".jpg") {
    WriteStill(path, videos, SIZE_MAX);
  } else {
    WriteVideo(path, videos);
  }
  for (const RolloutVideo& video : videos) {
    const bool halted = video.result.outcome == core::Outcome::kHalted;
    std::printf("%-16s %s%s%s after %d controls, %d of them recovery\n", video.title.c_str(),
                core::Name(video.result.outcome), halted ? ": " : "",
                halted ? control::Name(video.result.halt_cause) : "", video.result.controls(),
                video.result.recovery_controls());
  }
  std::printf("%s\n", path.c_str());
}

void RunRender(const RenderOptions& options) {
  std::vector<safety::Method> methods;
  for (const std::string& name : options.methods) methods.push_back(study::ParseMethod(name));
  PusherTrialRunner runner(Model::Load(options.model), methods, options.plant, {});
  const std::vector<RolloutVideo> videos =
      RecordRollouts(runner, options.methods, options.seed, core::DeriveSeed(options.seed, {1}),
                     options.width, options.height);
  Save(videos, options.out);
}

namespace {

// Shows each state in the window, slowly enough to follow.
class WindowObserver final : public control::RolloutObserver {
 public:
  WindowObserver(sim::PusherWindow& window, const sim::PusherPlant& plant, std::string title)
      : window_(&window), plant_(&plant), title_(std::move(title)) {}

  void OnStart(std::span<const double> /*x*/) override { Show("start", 0.7); }

  void OnControl(const control::RolloutEvent& event) override {
    const bool policy = event.step.mode == control::Mode::kPolicy;
    Show(core::Format("t = %d  %s  g = %.4f", event.step.t, control::Name(event.step.mode),
                      event.step.g),
         policy ? 0.12 : 0.016);
  }

  void OnEnd(const control::RolloutResult& result) override {
    const bool halted = result.outcome == core::Outcome::kHalted;
    Show(std::string(core::Name(result.outcome)) +
             (halted ? std::string(": ") + control::Name(result.halt_cause) : ""),
         1.5);
  }

  [[nodiscard]] bool open() const noexcept { return open_; }

 private:
  void Show(const std::string& text, double seconds) {
    if (open_) open_ = window_->Show(*plant_, title_, text, seconds);
  }

  sim::PusherWindow* window_;
  const sim::PusherPlant* plant_;
  std::string title_;
  bool open_ = true;
};

}  // namespace

void RunView(const ViewOptions& options) {
  PusherTrialRunner runner(Model::Load(options.model), {study::ParseMethod(options.method)},
                           options.plant, {});
  sim::PusherWindow window(runner.plant(), "pusher: " + options.method);
  bool open = true;
  for (std::uint64_t episode = 0; open; ++episode) {
    const std::uint64_t seed = options.seed + episode;
    WindowObserver observer(window, runner.plant(),
                            options.method + ", start state " + std::to_string(seed));
    runner.RunObserved(0, seed, core::DeriveSeed(seed, {1}), &observer);
    open = observer.open();
  }
}

}  // namespace dfr::apps::pusher
