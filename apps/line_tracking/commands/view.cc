#include <opencv2/imgproc.hpp>

#include "apps/window_observer.h"
#include "commands/commands.h"
#include "dfr/core/random.h"
#include "dfr/sim/line_tracking/line_tracking_window.h"
#include "rollout_video.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

// Draws the results of vision, at half size.
std::vector<std::uint8_t> Inset(const sim::LineTrackingPlant& plant) {
  std::vector<std::uint8_t> seen = DrawWhatVisionSees(plant);
  const cv::Mat picture(480, 640, CV_8UC3, seen.data());
  std::vector<std::uint8_t> inset(std::size_t{3} * 240 * 320);
  cv::Mat half(240, 320, CV_8UC3, inset.data());
  cv::resize(picture, half, half.size(), 0.0, 0.0, cv::INTER_AREA);
  cv::cvtColor(half, half, cv::COLOR_BGR2RGB);
  return inset;
}

}  // namespace

void RunView(const ViewOptions& options) {
  static_cast<void>(study::ParseMethod(options.method, kLoadedLineMethods));
  LineModel model = LineModel::Load(options.model);
  // The window precedes the plant, whose endoscope uses the window's OpenGL.
  sim::LineTrackingWindow window("line_tracking: " + options.method);
  LineTrialRunner runner(std::move(model), {options.method}, options.scene.plant,
                         LoadCalibration(options.scene));
  bool open = true;
  for (std::uint64_t episode = 0;
       open && (options.episodes == 0 || episode < static_cast<std::uint64_t>(options.episodes));
       ++episode) {
    const std::uint64_t seed = options.seed + episode;
    const std::string title = options.method + ", episode " + std::to_string(seed);
    WindowObserver observer([&](const std::string& text, double seconds) {
      return window.Show(runner.plant(), title, text, seconds, Inset(runner.plant()));
    });
    runner.RunObserved(0, seed, core::DeriveSeed(seed, {1}), &observer);
    open = observer.open();
  }
}

}  // namespace dfr::apps::line_tracking
