#include <opencv2/imgproc.hpp>

#include "commands/commands.h"
#include "dfr/core/random.h"
#include "dfr/sim/line_tracking/line_tracking_window.h"
#include "rollout_video.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

// Shows every control, recoveries' many small ones faster.
class WindowObserver final : public control::RolloutObserver {
 public:
  WindowObserver(sim::LineTrackingWindow& window, const sim::LineTrackingPlant& plant,
                 std::string title)
      : window_(&window), plant_(&plant), title_(std::move(title)) {}

  void OnStart(std::span<const double> /*x*/) override { Show("", 0.5); }
  void OnControl(const control::RolloutEvent& event) override {
    const bool policy = event.step.mode == control::Mode::kPolicy;
    Show(std::string(control::Name(event.step.mode)) + ", t = " + std::to_string(event.step.t),
         policy ? 0.1 : 0.02);
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
    if (!open_) return;
    std::vector<std::uint8_t> seen = DrawWhatVisionSees(*plant_);
    const cv::Mat picture(480, 640, CV_8UC3, seen.data());
    std::vector<std::uint8_t> inset(std::size_t{3} * 240 * 320);
    cv::Mat half(240, 320, CV_8UC3, inset.data());
    cv::resize(picture, half, half.size(), 0.0, 0.0, cv::INTER_AREA);
    cv::cvtColor(half, half, cv::COLOR_BGR2RGB);
    open_ = window_->Show(*plant_, title_, text, seconds, inset);
  }

  sim::LineTrackingWindow* window_;
  const sim::LineTrackingPlant* plant_;
  std::string title_;
  bool open_ = true;
};

}  // namespace

void RunView(const ViewOptions& options) {
  LineModel model = LineModel::Load(options.model);
  // Created before the plant, whose endoscope uses the window's OpenGL.
  sim::LineTrackingWindow window("line_tracking: " + options.method);
  LineTrialRunner runner(std::move(model), {options.method}, options.scene.plant,
                         LoadCalibration(options.scene));
  bool open = true;
  for (std::uint64_t episode = 0;
       open && (options.episodes == 0 || episode < static_cast<std::uint64_t>(options.episodes));
       ++episode) {
    const std::uint64_t seed = options.seed + episode;
    WindowObserver observer(window, runner.plant(),
                            options.method + ", episode " + std::to_string(seed));
    runner.RunObserved(0, seed, core::DeriveSeed(seed, {1}), &observer);
    open = observer.open();
  }
}

}  // namespace dfr::apps::line_tracking
