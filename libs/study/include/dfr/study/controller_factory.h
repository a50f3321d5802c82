#pragma once

#include <array>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/core/plant.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"
#include "dfr/safety/task_model.h"
#include "dfr/study/fitted_task.h"
#include "dfr/study/policies.h"
#include "dfr/study/shared_cache.h"
#include "dfr/study/supports.h"

namespace dfr::study {

/// Methods of every program, in addition to the methods of safety::ParseMethod(). Two oracles try
/// controls on a copy of the simulation: "finite-difference", the oracle of the paper, and
/// "true-jacobian", a one-step filter (MakeTrueJacobianFilter()). The baselines have no support:
/// "lwr", "lwr-cv" and "knn" are regressions on the demonstrations themselves, "lwr-online" is a
/// regression that adapts to the effects of controls (OnlineLwrPolicy), "ensemble" halts when five
/// policies disagree, "dart" learns from demonstrations with injected noise, and "dagger" queries
/// the supervisor while it learns.
inline constexpr std::array<std::string_view, 9> kOtherMethods = {
    "finite-difference", "true-jacobian", "lwr",   "lwr-cv", "lwr-online", "knn",
    "ensemble",          "dart",          "dagger"};

/// Methods of kOtherMethods that a simulation offers for a model loaded from a file. The rest of
/// kOtherMethods need a learner or a supervisor.
inline constexpr std::array<std::string_view, 6> kLoadedMethods = {
    "finite-difference", "true-jacobian", "lwr", "lwr-cv", "lwr-online", "knn"};

/// Parts of a method's name, for example "controller@lwr/density".
struct MethodName {
  std::string_view controller;  ///< "certified" is valid only with a support.
  std::string_view policy;      ///< One of kPolicies; empty: the learned one.
  std::string_view support;     ///< One of kSupports; empty: the controller's default.
};
/// Splits a name. "lwr", "lwr-cv", "lwr-online", "knn", "dart" and "dagger" are short for
/// "baseline@lwr" and so on.
[[nodiscard]] MethodName Split(std::string_view name) noexcept;

/// Returns the policies of kPolicies that are valid after an @ in a program with the methods
/// `others`: a policy that is also one of kOtherMethods must be one of `others`. The remaining
/// policies, except "none", are valid only if the oracle "true-jacobian" is: they also need the
/// driven plant.
[[nodiscard]] std::vector<std::string_view> PoliciesFor(std::span<const std::string_view> others);

/// Same as safety::ParseMethod() with `others`, but also accepts names with one of PoliciesFor() or
/// a support.
/// @throws std::invalid_argument naming the unknown method, policy or support and listing the valid
///   ones.
[[nodiscard]] safety::Method ParseMethod(std::string_view name,
                                         std::span<const std::string_view> others = kOtherMethods);

/// Returns the valid arguments of ParseMethod() with explanations, for help texts.
[[nodiscard]] std::string MethodHelp(std::span<const std::string_view> others = kOtherMethods);

/// Returns true for a method that runs a policy without a guard, such as "baseline", "lwr",
/// "baseline@none" or "ensemble".
[[nodiscard]] bool IsPolicy(std::string_view method) noexcept;

/// Returns true for a method that needs the plant, such as "true-jacobian" or
/// "finite-difference@lwr".
[[nodiscard]] bool IsOracle(std::string_view method) noexcept;

/// Returns footnotes for tables of these methods, one per line. They mark oracles, adversaries, and
/// policies learned with the supervisor's help. Empty if there are none.
[[nodiscard]] std::string MarksOf(std::span<const std::string> methods);

/// Creates the controllers of one task by the names of their methods.
class ControllerFactory {
 public:
  /// Borrows `task`, `learned` and `demonstrations`, which must outlive this object and its
  /// controllers.
  ControllerFactory(const FittedTask& task, const core::Policy& learned,
                    const core::StateLayout& layout,
                    std::span<const core::Trajectory> demonstrations, Expert teaching = {})
      : task_(&task),
        learned_(&learned),
        layout_(layout),
        demonstrations_(demonstrations),
        policies_(task, learned, demonstrations, std::move(teaching)) {}

  /// Creates a controller. `plant` is the driven plant, which only oracles and adversaries use.
  /// @throws std::invalid_argument as ParseMethod(), or if the plant or the Expert that the
  ///   method needs is missing.
  [[nodiscard]] std::unique_ptr<control::Controller> Make(
      std::string_view method, const core::SimulatedPlant* plant,
      const safety::ControllerOptions& options = {}) const;

 private:
  [[nodiscard]] std::unique_ptr<control::Controller> OnSupport(
      const MethodName& name, const safety::Method& method, const core::Policy& policy,
      const safety::ControllerOptions& options) const;

  const FittedTask* task_;
  const core::Policy* learned_;
  core::StateLayout layout_;
  std::span<const core::Trajectory> demonstrations_;
  PolicyFactory policies_;
  mutable SharedCache<std::string, SupportModel> supports_;
};

}  // namespace dfr::study
