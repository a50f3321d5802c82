#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/core/policy.h"
#include "dfr/core/random.h"

namespace dfr::study {

/// Method whose rate of intervention the placebos use.
inline constexpr std::string_view kJudged = "guard";

/// Returns "placebo-corrections" and "placebo-halts".
[[nodiscard]] const std::vector<std::string>& PlaceboNames();
/// Returns true if `method` is one of PlaceboNames().
[[nodiscard]] bool IsPlacebo(std::string_view method) noexcept;

/// A policy that is interrupted as often as a guard interrupts it, at random times: each control
/// with the same probability, the rate. If the guard does better, the timing or the content of its
/// corrections matters. Next() never allocates.
class Placebo final : public control::Controller {
 public:
  using Distance = std::function<double(std::span<const double>, std::span<const double>)>;

  /// @param alone     The policy alone.
  /// @param nominal   Replacement of the policy's control: the demonstrated action. Null: the
  ///   episode halts instead.
  /// @param distance  Distance of two controls, for Step::change.
  Placebo(std::unique_ptr<control::Controller> alone, std::shared_ptr<const core::Policy> nominal,
          Distance distance);
  [[nodiscard]] int state_dim() const noexcept override { return alone_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return alone_->control_dim(); }
  void SetRate(double rate) noexcept { rate_ = rate; }

 private:
  void DoReset(std::uint64_t seed) noexcept override;
  control::Step DoNext(std::span<const double> x, std::span<double> u) noexcept override;

  std::unique_ptr<control::Controller> alone_;
  std::shared_ptr<const core::Policy> nominal_;
  Distance distance_;
  double rate_ = 0.0;
  core::Random random_{0};
  std::vector<double> control_;
};

}  // namespace dfr::study
