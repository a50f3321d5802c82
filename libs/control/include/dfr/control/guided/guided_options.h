#pragma once

#include <span>
#include <string_view>
#include <vector>

#include "dfr/control/guided/support_step.h"
#include "dfr/control/response/local_fit.h"

namespace dfr::control {

/// Options for GuidedController: properties of the task, then five constants for all tasks, and
/// switches for ablations. Levels are values of l. Controls, except control_limit, are in units of
/// the root mean square of demonstrated controls.
struct GuidedOptions {
  int horizon = 100;        ///< T: number of the learned policy's time steps in an episode, > 0.
  int first_step = 0;       ///< First time step and phase of an episode, in [0, T).
  int max_controls = 1200;  ///< Maximum number of controls of any kind in an episode, > 0.
  /// Largest absolute value of an entry of an applied control, >= 0: one for all entries, or one
  /// per entry.
  std::vector<double> control_limit = {1.0};
  /// Durations of controls, if the world also moves by itself. |v| = 1 is an ordinary control.
  DisturbanceModel disturbance_model = {};

  /// Maximum number of gradients of l per AscendSupport(), >= 0. A smaller number is faster, but
  /// may be too few if a control leads far outside. 0: no control is raised.
  int iterations = 6;
  /// If no control is predicted to end inside, the best one passes if it ends outside by at most
  /// this multiple of Levels::slack() and at most guided::kMaxExitLevel. An offset that no control
  /// can correct, such as a displaced object, then does not stop the task. With larger values, more
  /// episodes complete and more collide.
  double max_exit_ratio = 2.0;
  /// HaltRule::patience. Larger values add few completed episodes and more collisions.
  int patience = 12;
  /// Level at which the learned control passes unchanged. True: Levels::pass(), just inside, and
  /// Levels::pass_depth() below it in a world at rest (SafetyFilter), so a good policy is corrected
  /// only at the boundary. False: Levels::gate(), deep inside; below it, the nominal control of
  /// nearby demonstrations comes first, and the policy has little influence.
  bool least_intervention = false;
  /// Norm of a probe, >= 0. Its effect must exceed the observation noise and the disturbance during
  /// a control, but must be harmless in a wrong direction. 0: directions without demonstrated
  /// controls stay unknown.
  double probe_size = 0.35;
  /// For ablations. Weight of an applied control as a measurement of J, relative to demonstrations
  /// (ResponseOptions), >= 0. 0: J comes from demonstrations alone.
  double online_weight = 1.0;
  /// For ablations. Tries the nominal control of nearby demonstrations before changing the learned
  /// control.
  bool demonstrated = true;
  /// For ablations. Estimates a drift if demonstrations show one (Response::has_drift()).
  bool drift = true;
  /// For ablations. Estimates the lag and smooths observations (StateObserver).
  bool observer = true;
};

/// Returns the names of the parts that can be removed for ablations: "filter", "exit-level",
/// "demonstrated", "online-jacobian" (together with probes), "drift", "observer", and
/// "disturbance", the disturbance_model of a task that has one.
[[nodiscard]] std::span<const std::string_view> GuidedPartNames() noexcept;
/// Returns the options with these parts at neutral values; "filter+exit-level" removes both.
/// @throws std::invalid_argument naming the unknown part and the valid ones.
[[nodiscard]] GuidedOptions Without(GuidedOptions options, std::string_view parts);
/// Returns the limits of v, with u = control_unit v.
/// @throws std::invalid_argument unless there is one limit or one per entry of a control.
[[nodiscard]] StepLimits Limits(const GuidedOptions& options, int control_dim, double control_unit);
/// @throws std::invalid_argument naming the option that is out of range.
void Check(const GuidedOptions& options);

}  // namespace dfr::control
