#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "dfr/calibration/calibrate.h"
#include "dfr/control/rollout.h"
#include "dfr/experiment/progress.h"
#include "dfr/sim/line_tracking/line_tracking_plant.h"
#include "dfr/study/placebo_runner.h"
#include "model.h"

namespace dfr::apps::line_tracking {

/// Runs `count` open-loop demonstrations without the disturbance of `options`, and keeps those that
/// complete without a collision. Start states are a stream of `seed`. `progress` may be empty. The
/// provenance contains the origin `kSimulated` and the individual arm, but no date: equal options
/// give equal bytes.
/// @throws std::runtime_error if more than `count` demonstrations are unusable.
[[nodiscard]] imitation::DemonstrationSet Demonstrate(const sim::LineTrackingOptions& options,
                                                      const line_task::LineCalibration& known,
                                                      int count, int steps, std::uint64_t seed,
                                                      experiment::ProgressCallback progress = {});

/// Records a motion with the plant's arm and platform, and calibrates from it. The calibration has
/// the provenance of Demonstrate().
[[nodiscard]] line_task::LineCalibration CalibratePlant(const sim::LineTrackingOptions& options,
                                                        int frames, std::uint64_t seed,
                                                        calibration::CalibrationSummary* summary);

/// Collects the progress of recoveries: g divided by the gate's threshold after each iteration.
class RecoveryCurves final : public control::RolloutObserver {
 public:
  explicit RecoveryCurves(std::size_t wanted) : wanted_(wanted) {}
  void OnControl(const control::RolloutEvent& event) override;
  void OnEnd(const control::RolloutResult& result) override;
  [[nodiscard]] bool complete() const noexcept { return curves_.size() >= wanted_; }
  /// One curve per recovery: entry i is g / threshold at its iteration i, clamped to [0, 1].
  [[nodiscard]] const std::vector<std::vector<double>>& curves() const noexcept { return curves_; }

 private:
  void Finish(bool reached);

  std::size_t wanted_;
  std::vector<double> current_;
  std::vector<std::vector<double>> curves_;
};

/// Returns `plant` in the world of this name: "frozen", in which the platform stops while the robot
/// observes, computes or has halted; or a latency in real time, "30ms".
/// @throws std::invalid_argument listing the valid worlds.
[[nodiscard]] sim::LineTrackingOptions InWorld(sim::LineTrackingOptions plant,
                                               const std::string& world);

/// Seconds after a halt during which the platform may move the line away from the tip.
inline constexpr double kSettleTimeS = 5.0;

/// One unit of the experiment: a model, and a plant to run it on.
class LineTrialRunner final : public study::PlaceboRunner {
 public:
  LineTrialRunner(LineModel model, const std::vector<std::string>& methods,
                  const sim::LineTrackingOptions& plant, const line_task::LineCalibration& known);

  [[nodiscard]] std::map<std::string, double> Measures() override;
  [[nodiscard]] bool Film(const std::vector<int>& methods, std::uint64_t start_seed,
                          std::uint64_t controller_seed,
                          const std::filesystem::path& path) override;

  [[nodiscard]] const sim::LineTrackingPlant& plant() const noexcept {
    return static_cast<const sim::LineTrackingPlant&>(undisturbed());
  }
  [[nodiscard]] const LineModel& model() const noexcept { return model_; }

 private:
  [[nodiscard]] bool Inside(std::span<const double> x) const override;
  [[nodiscard]] std::string CauseOf(const control::RolloutResult& result) const override;
  /// In real time, moves the platform for kSettleTimeS. Returns true if the tip then collides.
  [[nodiscard]] bool CollidesAfterHalt() override;

  LineModel model_;
};

}  // namespace dfr::apps::line_tracking
