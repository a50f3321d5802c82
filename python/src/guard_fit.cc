#include "guard_fit.h"

#include <pybind11/stl.h>

#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "arrays.h"
#include "dfr/core/contract.h"
#include "dfr/core/features/absolute_actions.h"
#include "dfr/safety/guard_advice.h"
#include "dfr/safety/guard_model.h"

namespace py = pybind11;

namespace dfr::python {
namespace {

using safety::Guard;
using safety::GuardModel;

// Size of a block, or height, width and channels of a picture.
using Size = std::variant<int, std::vector<int>>;

core::StateLayout Layout(const std::vector<std::pair<std::string, Size>>& blocks, int state_dim) {
  core::StateLayout layout;
  for (const auto& [name, size] : blocks) {
    for (const auto& other : layout.blocks) {
      DFR_THROW_UNLESS(other.name != name, "the layout contains '" << name << "' twice");
    }
    if (const int* const entries = std::get_if<int>(&size)) {
      layout.Add(name, *entries);
      continue;
    }
    const auto& shape = std::get<std::vector<int>>(size);
    DFR_THROW_UNLESS(shape.size() == 2 || shape.size() == 3,
                     "the layout gives '" << name << "' " << shape.size()
                                          << " sizes; a picture has (height, width, channels)");
    layout.Add(name, core::PictureShape{shape[0], shape[1], shape.size() == 3 ? shape[2] : 1});
  }
  if (blocks.empty()) layout.Add("state", state_dim);
  return layout;
}

// Converts actions that are positions if `differences` is set; otherwise rejects them, unless
// `as_recorded` is set.
void MakeIncrements(const core::StateLayout& layout, bool differences, bool as_recorded,
                    std::vector<core::Trajectory>& demonstrations) {
  if (as_recorded && !differences) return;
  // The fit reports inconsistent sizes.
  for (const core::Trajectory& episode : demonstrations) {
    if (episode.states.cols() != layout.state_dim() ||
        episode.controls.cols() != demonstrations[0].controls.cols() ||
        episode.states.rows() != episode.controls.rows() + 1 || !episode.states.allFinite() ||
        !episode.controls.allFinite()) {
      return;
    }
  }
  const auto absolute = core::FindAbsoluteActions(demonstrations);
  DFR_THROW_UNLESS(!differences || !absolute.empty(),
                   "no action takes the values of a state's entry, so differences=True has nothing "
                   "to convert");
  DFR_THROW_UNLESS(
      differences || absolute.empty(),
      core::Describe(absolute, layout)
          << ". A guard needs velocities or increments, for which zero means no motion. "
             "Subtract the present state from actions, here by differences=True and "
             "before each filter(), or pass as_recorded=True if zero does mean no motion");
  for (core::Trajectory& episode : demonstrations) core::ToDifferences(absolute, episode);
}

// Converts pairs of name and size, or a dict of them.
core::StateLayout LayoutOption(const py::object& blocks, int state_dim) {
  using Blocks = std::vector<std::pair<std::string, Size>>;
  const py::object pairs =
      py::isinstance<py::dict>(blocks) ? py::list(blocks.attr("items")()) : blocks;
  return Layout(Option<Blocks>(pairs, "layout",
                               "a list of pairs (name, size), or (name, (height, width, channels)) "
                               "for a picture"),
                state_dim);
}

// Converts "object,tip[0:2]", or a list of such names.
std::string FeaturesOption(const py::object& features) {
  if (!py::isinstance<py::list>(features) && !py::isinstance<py::tuple>(features)) {
    return TextOption(features, "features");
  }
  std::string joined;
  for (const std::string& name :
       Option<std::vector<std::string>>(features, "features", "names of parts of the state")) {
    if (!joined.empty()) joined += ',';
    joined += name;
  }
  return joined;
}

Guard FitGuard(const Arrays& all_states, const Arrays& all_actions, const py::object& layout,
               const py::object& features, const py::object& nu, const py::object& gamma,
               const py::object& strategy, const py::object& horizon,
               const py::object& action_limit, const py::object& false_alarms,
               const py::object& confidence, const py::object& hold_out,
               const py::object& error_factor, const py::object& source,
               const py::object& differences, const py::object& as_recorded,
               const py::object& accept_any, const py::object& progress) {
  const std::vector<Array>& states = all_states.each;
  const std::vector<Array>& actions = all_actions.each;
  DFR_THROW_UNLESS(states.size() == actions.size(),
                   "there are " << states.size() << " arrays of states and " << actions.size()
                                << " of actions; pass lists with one array "
                                   "of each per demonstration");
  DFR_THROW_UNLESS(!states.empty(), "there are no demonstrations");
  std::vector<core::Trajectory> demonstrations;
  for (std::size_t i = 0; i < states.size(); ++i) {
    DFR_THROW_UNLESS(states[i].ndim() == 2 && actions[i].ndim() == 2,
                     "states and actions of demonstration "
                         << i << " must have 2 dimensions, not " << states[i].ndim() << " and "
                         << actions[i].ndim()
                         << ": a list of one array (time, entries) per demonstration is needed; "
                            "array[:, None] turns a vector into a column");
    core::Trajectory demonstration;
    demonstration.states = Rows(states[i], "states");
    demonstration.controls = Rows(actions[i], "actions");
    demonstrations.push_back(std::move(demonstration));
  }
  safety::GuardOptions options;
  options.features = core::StripObservationPrefixes(FeaturesOption(features));
  options.support.svm.nu = RealOption(nu, "nu");
  options.support.svm.gamma = RealOption(gamma, "gamma");
  options.strategy = safety::ParseStrategy(TextOption(strategy, "strategy"));
  options.horizon = WholeOption(horizon, "horizon");
  options.action_limit = RealsOption(action_limit, "action_limit");
  options.false_alarms = RealOption(false_alarms, "false_alarms");
  options.confidence = RealOption(confidence, "confidence");
  options.hold_out = RealOption(hold_out, "hold_out");
  options.error_factor = RealOption(error_factor, "error_factor");
  options.source = TextOption(source, "source");
  const bool convert = FlagOption(differences, "differences");
  const bool accept = FlagOption(as_recorded, "as_recorded");
  options.accept_any = FlagOption(accept_any, "accept_any");
  Interruptible interruptible;
  options.support.svm.progress = [&](const kernel::FitProgress&) { return interruptible.GoOn(); };
  options.progress = [&](std::string_view stage, double share) {
    if (!interruptible.GoOn()) return false;
    if (progress.is_none()) return true;
    const std::string text(stage);
    WithLock([&] {
      // Python's C interface leaves no object to destroy if the interpreter ends within the call.
      PyObject* const result = PyObject_CallFunction(progress.ptr(), "sd", text.c_str(), share);
      if (result == nullptr) throw py::error_already_set();
      Py_DECREF(result);
    });
    return true;
  };
  const core::StateLayout blocks =
      LayoutOption(layout, static_cast<int>(demonstrations[0].states.cols()));
  std::shared_ptr<const GuardModel> model;
  try {
    const Unlocked unlocked;
    MakeIncrements(blocks, convert, accept, demonstrations);
    model = GuardModel::Fit(blocks, demonstrations, options);
  } catch (const std::invalid_argument&) {
    // The parts of an interrupted fit may be inconsistent.
    interruptible.Throw();
    throw;
  }
  interruptible.Throw();
  // Skips the two wrappers of Guard.fit in dfr/__init__.py, up to the caller's line.
  constexpr int kCaller = 3;
  for (const std::string& warning : safety::Warnings(*model)) {
    const int raised =
        OrWaitForTheEnd([&] { return PyErr_WarnEx(PyExc_UserWarning, warning.c_str(), kCaller); });
    if (raised != 0) throw py::error_already_set();
  }
  return Guard(std::move(model));
}

}  // namespace

void AddGuardFit(py::class_<Guard>& guard_class) {
  guard_class.def_static(
      "fit", &FitGuard, py::arg("states"), py::arg("actions"), py::kw_only(),
      py::arg("layout") = std::vector<std::pair<std::string, int>>(), py::arg("features") = "",
      py::arg("nu") = safety::GuardOptions().support.svm.nu,
      py::arg("gamma") = safety::GuardOptions().support.svm.gamma, py::arg("strategy") = "guard",
      py::arg("horizon") = 0, py::arg("action_limit") = 0.0, py::arg("false_alarms") = 0.1,
      py::arg("confidence") = 0.0, py::arg("hold_out") = 0.0,
      py::arg("error_factor") = safety::GuardOptions().error_factor, py::arg("source") = "",
      py::arg("differences") = false, py::arg("as_recorded") = false, py::arg("accept_any") = false,
      py::arg("progress") = py::none(),
      R"(Learn a guard from demonstrations.

Parameters
----------
states : iterable of array_like of shape (n_actions_i + 1, state_dim)
    One array per demonstration, including the state after the last action.
actions : iterable of array_like of shape (n_actions_i, action_dim)
layout : sequence of (name, size) or dict, optional
    Names of the entries of a state, for `features`. Default: one block "state". A size (height, width) or
    (height, width, channels), with 1 or 3 channels, makes a block a picture of values from 0 to 255, rows
    from the top.
features : str or list of str
    Features, as in "object,tip[0:2]"; all entries if empty. "obs/object" means "object".
    "points:image[:K][:grey][:HxW][:light=none|gain|standard]" stands for K slow features of the positions
    of patches in a picture, "pca:embedding[:K]" for K principal components of a block, "slow:embedding[:K]"
    for K slow features of these components. Without K the fit chooses their number and, for points and embeddings,
    uses directions that actions depend on if these explain more. The other options are for pictures: one
    channel, the size after averaging, and the light: "standard" (the default) removes brightness and
    contrast, "gain" removes only the brightness. See docs/pixels.md.
nu, gamma : float
    Parameters of the supports; gamma is in whitened units, which all tasks share. The fit doubles gamma if
    the supports then cover more left-out states per volume, and while they cover gaps between modes.
strategy : {"guard", "controller", "dfr", "early-stopping", "monitor", "certified"}
    Source of the actions. "guard": the policy, whose action passes unchanged while it is predicted to end
    inside; at the boundary it is corrected. "controller": the demonstrations; the policy's action passes
    only deep inside. Use it for a policy that is known to be bad, or without one. "dfr": the policy, with
    Derivative-Free Recovery as published. "early-stopping": the policy, until a halt at the boundary.
    "monitor": the policy alone, with alarms. "certified": only actions that provably raise no alarm, under
    the assumptions of docs/certificates.md.
horizon : int
    Largest number of the policy's actions in an episode; 0: twice the number in the longest demonstration.
action_limit : float or sequence of float
    Limit of the magnitude of each entry of an action, or of all entries; 0: 1.5 times the largest
    demonstrated value of each entry.
false_alarms : float
    Share of demonstrations that may raise an alarm.
confidence : float
    Confidence that this fit keeps the bound false_alarms; 0: fits keep it on average.
hold_out : float
    Share of the demonstrations to leave out of the fit: the bounds of alarm and certificate are then
    exact. 0: none, and the bounds are approximate.
error_factor : float
    For strategy "certified": factor by which the predicted response to actions may be less accurate than
    in demonstrations.
source : str
    Origin of the demonstrations, stored in the file.
differences : bool
    Convert actions that are target positions, actions[t, k] = states[t, j] or states[t + 1, j], to
    increments by subtracting states[t, j]. Also subtract the present state's entry j from the policy's
    actions before `filter`. For an angle with jumps, d - period * round(d / period) is the increment of the
    difference d, in the fit and before `filter`, with the period in `periods`.
as_recorded : bool
    Accept actions that look like target positions, which are refused otherwise.
accept_any : bool
    Accept a fit in which almost no state of left-out demonstrations is inside, or in which a guard with
    components would stop the demonstrator. Such a fit is refused otherwise.
progress : callable(stage: str, share: float) or bool, optional
    None: in a terminal or notebook, show the progress of a fit of more than 2 s. True: always. False: never.

Raises
------
ValueError
    If a demonstration or option is invalid; the message names it, or the features to choose instead.
TypeError
    If a demonstration is not numeric or an option has the wrong type; the message names it.

Warns
-----
UserWarning
    For each of summary["warnings"].
)");
}

}  // namespace dfr::python
