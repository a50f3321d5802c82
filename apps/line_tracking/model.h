#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/core/policy.h"
#include "dfr/kernel/model_selection.h"
#include "dfr/study/learned_model.h"

namespace dfr::apps::line_tracking {

/// Options for LineModel::Fit().
struct LineModelOptions {
  std::vector<int> hidden = {64, 64};  ///< Tanh units of the policy's layers.
  std::string support_features = "tip[0:1],distance";
  double nu = 0.05;  ///< Largest share of the demonstrated states outside.
  /// Candidates for gamma, 1/mm^2. With several, kernel::SelectModel() chooses by held-out
  /// demonstrations (Sec. V-B): the tightest support that accepts `acceptance` of their states or,
  /// if there is none, the support that accepts most states.
  std::vector<double> gammas = {0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0};
  /// Share of held-out states that the chosen support must accept, by default 1 - nu. The gate's
  /// threshold lambda |u| of a tighter support exceeds the largest g at some time step, and DFR
  /// halts there.
  double acceptance = 0.95;
  double whitened_gamma =
      kernel::WhitenedSupportOptions()
          .svm.gamma;      ///< Gamma of the whitened support of guard and controller.
  int horizon = 55;        ///< T: number of the learned policy's controls per episode.
  std::uint64_t seed = 1;  ///< Seed of the network's initial weights.
};

/// Constants of this task's controllers. "dfr" is Algorithm 1 with steps larger than the noise of
/// images, probe g / (10 lambda), step g / (2 lambda); "dfr-fine" has the paper's constants.
/// "controller" estimates the platform's disturbance during a control;
/// "controller-without-disturbance" attributes it to the control.
[[nodiscard]] safety::ControllerOptions Controllers();

/// Methods of study::kOtherMethods that query no supervisor, because the demonstrations are
/// open-loop, and "proportional": a scripted policy that moves along the line by 1 mm per control
/// and corrects 0.8 of the measured distance, without learning or support.
inline constexpr std::array<std::string_view, 8> kOtherLineMethods = {
    "finite-difference", "true-jacobian", "lwr",      "lwr-cv",
    "lwr-online",        "knn",           "ensemble", "proportional"};

/// kOtherLineMethods for a model loaded from a file, in simulation.
inline constexpr std::array<std::string_view, 7> kLoadedLineMethods = {
    "finite-difference", "true-jacobian", "lwr", "lwr-cv", "lwr-online", "knn", "proportional"};
/// kOtherLineMethods on a robot, which no oracle can copy.
inline constexpr std::array<std::string_view, 5> kRobotLineMethods = {"lwr", "lwr-cv", "lwr-online",
                                                                      "knn", "proportional"};

/// Returns the policy of "proportional".
[[nodiscard]] const core::Policy& ProportionalPolicy() noexcept;

/// LearnedModel of line tracking.
class LineModel : public study::LearnedModel {
 public:
  /// @throws std::invalid_argument if there are fewer than 8 demonstrations or invalid options.
  static LineModel Fit(const imitation::DemonstrationSet& set, const LineModelOptions& options,
                       kernel::Selection* selection = nullptr);

  /// @throws std::runtime_error naming a missing or damaged file.
  static LineModel Load(const std::filesystem::path& folder);

  /// Returns a controller that borrows this model. `method` is a name that study::ParseMethod()
  /// accepts with kOtherLineMethods. Only oracles and adversaries need `plant`.
  /// @throws std::invalid_argument listing the valid names for an unknown one.
  [[nodiscard]] std::unique_ptr<control::Controller> MakeController(
      const std::string& method, const core::SimulatedPlant* plant = nullptr) const;

 private:
  // NOLINTNEXTLINE(google-explicit-constructor): constructed only here
  LineModel(study::LearnedModel learned) : study::LearnedModel(std::move(learned)) {}
};

}  // namespace dfr::apps::line_tracking
