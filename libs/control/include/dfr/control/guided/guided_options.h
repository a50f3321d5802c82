#pragma once

#include <span>
#include <string_view>
#include <vector>

#include "dfr/control/guided/response_estimate.h"
#include "dfr/control/guided/support_step.h"

namespace dfr::control {

/// Options for GuidedController: what the task says, then five constants that are meant for every
/// task, and switches for ablations. Levels are values of l, controls are in units of the
/// demonstrations' root mean square.
struct GuidedOptions {
  int horizon = 100;        ///< T: time steps of the learned policy in an episode, > 0.
  int first_step = 0;       ///< Time step and phase that an episode begins with, in [0, T).
  int max_controls = 1200;  ///< In an episode, of any kind, > 0.
  /// Each entry of an applied control is within +- this, >= 0: one limit for all, or one each.
  std::vector<double> control_limit = {1.0};
  /// Where something else moves the world: the time that controls take, |v| = 1 an ordinary one.
  DisturbanceModel disturbance_model = {};

  /// Gradients of l in one step, >= 0. Fewer decide faster and reach less where the learned control
  /// is far off; 0 changes nothing and leaves the learned control alone.
  int iterations = 6;
  /// Where no control is predicted to end inside, the best one passes down to this multiple of
  /// Levels::slack() outside, at most .8 in all: what no control can mend, an object off to
  /// the side, must not stop the task. More completes more and collides more.
  double max_exit_ratio = 2.0;
  /// HaltRule::patience. More completes little and collides more.
  int patience = 12;
  /// Where the learned control passes as it is. True: where it is predicted to end inside
  /// (Levels::pass), so that a good policy drives and is corrected at the boundary
  /// alone. False: where it is predicted to end deep inside (Levels::gate); elsewhere what
  /// demonstrations did nearby comes first, so that demonstrations drive and the policy hardly
  /// matters.
  bool least_intervention = false;
  /// Size of a probe, >= 0: above the noise of observations and what drifts meanwhile, below what a
  /// wrong direction may cost. 0: directions of control that nobody has used stay unknown.
  double probe_size = 0.35;
  /// Not to be tuned. Weight of an applied control as a measurement of J, relative to the
  /// demonstrations' (in ResponseOptions), >= 0. 0: J is the demonstrations' alone.
  double online_weight = 1.0;
  /// Not to be tuned. Whether what demonstrations did nearby is tried before the learned control is
  /// changed.
  bool demonstrated = true;
  /// Not to be tuned. Whether features may move by themselves, where demonstrations say so
  /// (Response::has_drift()).
  bool drift = true;
  /// Not to be tuned. Whether late effects are found and noise in what is seen is smoothed
  /// (StateObserver).
  bool observer = true;
};

/// The parts of guided recovery that can be taken out, for ablations: "filter", "exit-level",
/// "demonstrated", "online-jacobian" (and the probes for it), "drift", "observer", and
/// "disturbance", the disturbance_model of a task that has one.
[[nodiscard]] std::span<const std::string_view> GuidedPartNames() noexcept;
/// The options with these parts at their neutral values; "filter+exit-level" takes out both.
/// @throws std::invalid_argument naming the part that does not exist, and those that do.
[[nodiscard]] GuidedOptions Without(GuidedOptions options, std::string_view parts);
/// What its controls have to respect, |u| = control_unit |v|.
/// @throws std::invalid_argument if there are not as many limits as controls.
[[nodiscard]] StepLimits Limits(const GuidedOptions& options, int control_dim, double control_unit);
/// @throws std::invalid_argument naming the option that is out of range.
void Check(const GuidedOptions& options);

}  // namespace dfr::control
