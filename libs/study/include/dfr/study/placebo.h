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
#include "dfr/safety/method.h"
#include "dfr/study/controller_factory.h"
#include "dfr/study/online_lwr.h"

namespace dfr::study {

/// Method whose rate of intervention the placebos copy.
inline constexpr std::string_view kJudged = "guard";

/// Returns "placebo-corrections" and "placebo-halts".
[[nodiscard]] const std::vector<std::string>& PlaceboNames();
/// Returns true if `method` is one of PlaceboNames(), alone or with a policy, as in
/// "placebo-halts@lwr".
[[nodiscard]] bool IsPlacebo(std::string_view method) noexcept;

/// Returns true for a placebo or an oracle: a method for comparison, not for use.
[[nodiscard]] bool IsComparison(std::string_view method) noexcept;
/// Returns `method` with another controller around the same policy, as in "guard@lwr".
[[nodiscard]] std::string WithController(std::string_view controller, std::string_view method);
/// Same as ParseMethod(), but for a placebo returns the method of the policy alone under the
/// placebo's name.
/// @throws std::invalid_argument as ParseMethod() does.
[[nodiscard]] safety::Method ParseCompared(
    std::string_view method, std::span<const std::string_view> others = kOtherMethods);
/// @throws std::invalid_argument if `methods` contains a placebo without kJudged around the same
/// policy.
void CheckPlacebos(std::span<const std::string> methods);

/// Interrupts a policy at random times as often as a guard does: at each control with the same
/// probability (the rate). If the guard performs better, the timing or the content of its
/// corrections matters. Next() never allocates.
class Placebo final : public control::Controller {
 public:
  using Distance = std::function<double(std::span<const double>, std::span<const double>)>;

  /// @param alone     The policy alone.
  /// @param nominal   Replacement of the policy's control: the demonstrated action. Null: the
  ///   episode halts instead.
  /// @param distance  Distance between two controls, for Step::change.
  Placebo(std::unique_ptr<control::Controller> alone, std::shared_ptr<const core::Policy> nominal,
          Distance distance);
  [[nodiscard]] int state_dim() const noexcept override { return alone_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return alone_->control_dim(); }
  void SetRate(double rate) noexcept { rate_ = rate; }

 private:
  void DoReset(std::uint64_t seed) noexcept override;
  control::Step DoNext(std::span<const double> x, std::span<double> u) noexcept override;

  std::unique_ptr<control::Controller> alone_;
  LearnsOnline* learner_;  // alone_ if it learns, otherwise null
  std::shared_ptr<const core::Policy> nominal_;
  Distance distance_;
  double rate_ = 0.0;
  core::Random random_{0};
  std::vector<double> control_;
};

}  // namespace dfr::study
