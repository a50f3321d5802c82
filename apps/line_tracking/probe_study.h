#pragma once

#include <array>
#include <string>
#include <vector>

#include "dfr/control/rollout.h"
#include "dfr/sim/line_tracking/line_tracking_plant.h"
#include "model.h"

namespace dfr::apps::line_tracking {

/// Information in Algorithm 1's probes. Compares each probe of the observed episodes with the true
/// values of the simulation.
class ProbeStudy final : public control::RolloutObserver {
 public:
  /// Borrows both arguments.
  ProbeStudy(const LineModel& model, const sim::LineTrackingPlant& plant);

  void OnStart(std::span<const double> x) override;
  void OnControl(const control::RolloutEvent& event) override;
  void OnEnd(const control::RolloutResult& result) override;

  [[nodiscard]] int probes() const noexcept { return static_cast<int>(sizes_um_.size()); }
  /// Median length of a probe [um].
  [[nodiscard]] double size_um() const;
  /// Median error of the measured change of the distance to the line across a probe [um].
  [[nodiscard]] double error_um() const;
  /// Share of probes for which the measured sign of the change of g is correct.
  [[nodiscard]] double right_sign() const noexcept;
  [[nodiscard]] int recoveries() const noexcept { return recoveries_; }
  /// Number of recoveries that ended in a control of the learned policy.
  [[nodiscard]] int ended() const noexcept { return ended_; }
  /// Number of recoveries whose threshold lambda |u| exceeded g_t of every demonstrated state.
  [[nodiscard]] int out_of_reach() const noexcept { return out_of_reach_; }

 private:
  const LineModel* model_;
  const sim::LineTrackingPlant* plant_;
  std::vector<double> largest_g_;  ///< Largest g over demonstrated states, per time step.
  std::array<double, 4> before_{};
  bool recovering_ = false;
  std::vector<double> sizes_um_;
  std::vector<double> errors_um_;
  int right_ = 0;
  int recoveries_ = 0;
  int ended_ = 0;
  int out_of_reach_ = 0;
};

}  // namespace dfr::apps::line_tracking
