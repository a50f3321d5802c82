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
  double nu = 0.05;  ///< The quantile of the demonstrated states that may be outside.
  /// Candidates for the kernel's width, 1/mm^2. Where there are several, kernel::SelectModel()
  /// chooses by held-out demonstrations (Sec. V-B): the tightest support that accepts `acceptance`
  /// of their states; where none does, the one that accepts most.
  std::vector<double> gammas = {0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0};
  /// What nu promises, 1 - nu. A tighter support has its gate's threshold lambda |u| beyond the
  /// largest g at some time step, and DFR halts there.
  double acceptance = 0.95;
  double guided_gamma = kernel::WhitenedSupportOptions()
                            .svm.gamma;  ///< Guided recovery's support, in whitened units.
  int horizon = 55;                      ///< T: controls of the learned policy in an episode.
  std::uint64_t seed = 1;                ///< Draws the network's first weights.
};

/// The constants of this task's controllers. "dfr" is Algorithm 1 with steps larger than the noise
/// of images, probe g / (10 lambda), step g / (2 lambda); "dfr-fine" has the paper's. "guided"
/// knows that the platform moves on during a control; "guided-without-drift" takes what the
/// platform does for the answer to controls.
[[nodiscard]] safety::ControllerOptions Controllers();

/// Those of study::kOtherMethods that need no supervisor to ask, for the demonstrations here are
/// open-loop, and "proportional": a scripted policy that goes on along the line by 1 mm a
/// control and corrects 0.8 of the distance that was seen, without learning or support.
inline constexpr std::array<std::string_view, 7> kOtherLineMethods = {
    "finite-difference", "true-jacobian", "lwr", "lwr-cv", "knn", "ensemble", "proportional"};

/// What drives "proportional".
[[nodiscard]] const core::Policy& ProportionalPolicy() noexcept;

/// LearnedModel of line tracking.
class LineModel : public study::LearnedModel {
 public:
  /// @throws std::invalid_argument if there are fewer than 8 demonstrations, or they do not fit.
  static LineModel Fit(const imitation::DemonstrationSet& set, const LineModelOptions& options,
                       kernel::Selection* selection = nullptr);

  static LineModel Load(const std::filesystem::path& folder);

  /// Borrows this model; `method` is one that study::ParseMethod() takes, with
  /// kOtherLineMethods; `plant`, the plant that is driven, is for "finite-difference" only.
  /// @throws std::invalid_argument naming what is unknown and what there is.
  [[nodiscard]] std::unique_ptr<control::Controller> MakeController(
      const std::string& method, const core::SimulatedPlant* plant = nullptr) const;

 private:
  // NOLINTNEXTLINE(google-explicit-constructor): made here only
  LineModel(study::LearnedModel learned) : study::LearnedModel(std::move(learned)) {}
};

}  // namespace dfr::apps::line_tracking
