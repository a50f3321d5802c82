#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "apps/study/planar/polynomial_policy.h"
#include "apps/study/planar/task.h"
#include "dfr/control/certified/certificate.h"
#include "dfr/control/certified/certificate_constants.h"
#include "dfr/control/controller.h"
#include "dfr/control/guided/guided_controller.h"
#include "dfr/kernel/time_varying_support.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/task_model.h"
#include "dfr/study/controller_factory.h"

namespace dfr::study::planar {

/// Options of the methods.
struct MethodOptions {
  /// Gamma of guided recovery's support, in whitened units.
  double gamma = kernel::WhitenedSupportOptions().svm.gamma;
  bool whitening = true;
  bool phase_whitening = true;
  bool hold_ended = true;
  int window = 2;
  control::GuidedOptions guided = {};
  double raw_gamma = 0.0;        ///< Gamma of the paper's support; 0: the task's.
  double error_factor = 2.0;     ///< Safety factor on eps.
  double certified_level = 0.0;  ///< control::Certificate::level of certified-direction.
};

/// The certified method and study::kOtherMethods.
inline constexpr std::array<std::string_view, 10> kPlanarMethods = {"certified-direction",
                                                                    "finite-difference",
                                                                    "true-jacobian",
                                                                    "lwr",
                                                                    "lwr-cv",
                                                                    "lwr-online",
                                                                    "knn",
                                                                    "ensemble",
                                                                    "dart",
                                                                    "dagger"};

/// Support of a method: of unscaled states, or of whitened features.
enum class SupportKind { kRaw, kGuided };
/// @throws std::invalid_argument for a name with a support, such as "dfr/density".
[[nodiscard]] SupportKind SupportOf(std::string_view method);

/// Options for the model of a planar task.
[[nodiscard]] safety::TaskOptions TaskOptionsOf(const Task& task, const MethodOptions& options);

/// Supervisor of a planar task, which baselines can query; the caller sets the learner.
[[nodiscard]] Expert SupervisorOf(const Task& task);

/// Everything learned from one set of demonstrations, and controllers that use it.
class Methods {
 public:
  /// `seed` is for baselines that learn again.
  /// @throws std::invalid_argument if the demonstrations do not suffice.
  Methods(const Task& task, std::vector<core::Trajectory> demonstrations,
          const MethodOptions& options = {}, std::uint64_t seed = 0);
  Methods(const Methods&) = delete;
  Methods& operator=(const Methods&) = delete;

  /// Creates the controller `method`, a name that ParseMethod() accepts with kPlanarMethods. Only
  /// oracles and adversaries borrow `plant`.
  /// @throws std::invalid_argument for another name.
  [[nodiscard]] std::unique_ptr<control::Controller> Make(std::string_view method,
                                                          const core::SimulatedPlant& plant) const;

  [[nodiscard]] const std::vector<core::Trajectory>& demonstrations() const noexcept {
    return demonstrations_;
  }
  [[nodiscard]] const safety::TaskModel& model() const noexcept { return fit_.model(); }
  [[nodiscard]] const FittedTask& fit() const noexcept { return fit_; }
  /// The paper's support on whole states.
  [[nodiscard]] const kernel::TimeVaryingSupport& raw_support() const noexcept {
    return *model().published();
  }
  /// l_t(x) of a whole state.
  [[nodiscard]] double Level(SupportKind kind, int t, std::span<const double> x) const;
  /// Returns true if an episode may begin at x: x is inside the paper's support and the support of
  /// guided recovery, both with default options, and the support of all entries in one scale.
  [[nodiscard]] bool Begins(std::span<const double> x) const;
  /// Estimate of eps from the demonstrations, without the safety factor.
  [[nodiscard]] const control::EstimatedConstant& direction_error() const noexcept {
    return direction_error_;
  }
  /// Returns the certificate of certified-direction.
  [[nodiscard]] control::Certificate certificate() const noexcept;

 private:
  Task task_;
  MethodOptions options_;
  std::vector<core::Trajectory> demonstrations_;
  PolynomialPolicy policy_;
  FittedTask fit_;
  safety::TaskModel start_model_;
  core::FeatureTransform start_features_;
  kernel::WhitenedSupport start_support_;
  ControllerFactory controllers_;
  control::EstimatedConstant direction_error_;
};

}  // namespace dfr::study::planar
