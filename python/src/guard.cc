#include "dfr/safety/guard.h"

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "arrays.h"
#include "dfr/core/absolute_actions.h"
#include "dfr/core/contract.h"
#include "dfr/core/rotations.h"
#include "dfr/safety/guard_advice.h"
#include "dfr/safety/guard_model.h"
#include "dfr/safety/onnx_export.h"
#include "guard_advice.h"

namespace py = pybind11;

namespace dfr::python {
namespace {

using safety::Guard;
using safety::GuardModel;
using safety::GuardSettings;
using safety::Verdict;

// The size of a block, or the height, width and channels of a picture.
using Size = std::variant<int, std::vector<int>>;

core::StateLayout Layout(const std::vector<std::pair<std::string, Size>>& blocks, int state_dim) {
  core::StateLayout layout;
  for (const auto& [name, size] : blocks) {
    for (const auto& other : layout.blocks) {
      DFR_THROW_UNLESS(other.name != name, "the layout names '" << name << "' twice");
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

// Converts actions that are positions if `differences` is set; rejects them otherwise.
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
  DFR_THROW_UNLESS(differences || absolute.empty(),
                   core::Describe(absolute, layout)
                       << ". A guard needs velocities or increments, of which zero holds still. "
                          "Subtract the present state from actions, here by differences=True and "
                          "before each filter(), or pass as_recorded=True if zero does hold still");
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

Guard Fit(const Arrays& all_states, const Arrays& all_actions, const py::object& layout,
          const py::object& features, const py::object& nu, const py::object& gamma,
          const py::object& strategy, const py::object& horizon, const py::object& action_limit,
          const py::object& false_alarms, const py::object& confidence, const py::object& hold_out,
          const py::object& error_factor, const py::object& source, const py::object& differences,
          const py::object& as_recorded, const py::object& accept_any, const py::object& progress) {
  const std::vector<Array>& states = all_states.each;
  const std::vector<Array>& actions = all_actions.each;
  DFR_THROW_UNLESS(states.size() == actions.size(),
                   "there are " << states.size() << " arrays of states and " << actions.size()
                                << " of actions; pass lists with one array "
                                   "of each a demonstration");
  DFR_THROW_UNLESS(!states.empty(), "there are no demonstrations");
  std::vector<core::Trajectory> demonstrations;
  for (std::size_t i = 0; i < states.size(); ++i) {
    DFR_THROW_UNLESS(states[i].ndim() == 2 && actions[i].ndim() == 2,
                     "states and actions of demonstration "
                         << i << " must have 2 dimensions, not " << states[i].ndim() << " and "
                         << actions[i].ndim()
                         << ": a list of one array (time, entries) a demonstration is needed; "
                            "array[:, None] makes one column of a vector");
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
    if (!progress.is_none()) {
      const py::gil_scoped_acquire lock;
      progress(std::string(stage), share);
    }
    return true;
  };
  const core::StateLayout blocks =
      LayoutOption(layout, static_cast<int>(demonstrations[0].states.cols()));
  std::shared_ptr<const GuardModel> model;
  try {
    const py::gil_scoped_release unlocked;
    MakeIncrements(blocks, convert, accept, demonstrations);
    model = GuardModel::Fit(blocks, demonstrations, options);
  } catch (const std::invalid_argument&) {
    // Parts of interrupted fits may not be consistent.
    interruptible.Throw();
    throw;
  }
  interruptible.Throw();
  // Past the two wrappers of Guard.fit in dfr/__init__.py, to the caller's line.
  constexpr int kCaller = 3;
  for (const std::string& warning : safety::Warnings(*model)) {
    if (PyErr_WarnEx(PyExc_UserWarning, warning.c_str(), kCaller) != 0)
      throw py::error_already_set();
  }
  return Guard(std::move(model));
}

// Returns None instead of NaN, which is inconvenient to compare and log.
py::object Number(double value) {
  return std::isnan(value) ? py::object(py::none()) : py::object(py::float_(value));
}

// A temporary folder for one file, because a guard is stored by its path alone.
class TemporaryFile {
 public:
  TemporaryFile() : folder_((std::filesystem::temp_directory_path() / "dfr-XXXXXX").string()) {
    if (mkdtemp(folder_.data()) == nullptr) {
      throw std::runtime_error(folder_ + ": cannot be created: " + std::strerror(errno));
    }
  }
  ~TemporaryFile() {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;

  [[nodiscard]] std::filesystem::path path() const {
    return std::filesystem::path(folder_) / "guard";
  }

 private:
  std::string folder_;
};

// Converts a guard to the content of its file, and back.
py::bytes ToBytes(const Guard& guard) {
  std::ostringstream content;
  {
    const py::gil_scoped_release unlocked;
    const TemporaryFile file;
    guard.model().Save(file.path());
    content << std::ifstream(file.path(), std::ios::binary).rdbuf();
  }
  return py::bytes(content.str());
}

Guard FromBytes(const std::string& content) {
  const py::gil_scoped_release unlocked;
  const TemporaryFile file;
  {
    std::ofstream out(file.path(), std::ios::binary);
    out.write(content.data(), static_cast<std::streamsize>(content.size()));
    out.close();
    if (!out) throw std::runtime_error(file.path().string() + ": cannot be written");
  }
  return Guard::Load(file.path());
}

py::tuple Filter(Guard& guard, const py::object& t, const Array& state, const Array& action) {
  py::array_t<double> safe = NewVector(guard.action_dim());
  const Verdict verdict = guard.Filter(StepOf(t), Entries(state), Entries(action), Entries(safe));
  py::dict info;
  info["why"] = safety::Explain(guard.model(), verdict, Entries(state), Entries(action));
  info["g"] = Number(verdict.g);
  info["threshold"] = Number(verdict.threshold);
  info["mode"] = control::Name(verdict.mode);
  info["reason"] = verdict.reason();
  info["source"] = safety::Name(verdict.source);
  info["changed"] = verdict.changed;
  info["change"] = Number(verdict.change);
  info["certified"] = verdict.certified;
  info["alarm"] = verdict.alarm;
  info["alarm_step"] = verdict.alarm_step;
  info["step"] = verdict.step;
  info["entry"] =
      verdict.entry < 0
          ? py::object(py::none())
          : py::object(py::str(core::EntryRange(guard.model().task_layout(), verdict.entry, 4)));
  return py::make_tuple(std::move(safe), std::move(info));
}

py::object Decision(const Guard& guard, const py::object& time, const Array& x) {
  const auto t = Steps(time);
  const MatrixView rows = Rows(x, "x");
  DFR_THROW_UNLESS(rows.cols() == guard.state_dim(),
                   "states of " << rows.cols() << " entries; the guard has " << guard.state_dim());
  DFR_THROW_UNLESS(t.ndim() == 0 || (t.ndim() == 1 && t.shape(0) == rows.rows()),
                   "t must be one time step, or one for each row of x");
  const bool shared = t.ndim() == 0;
  const std::int64_t* steps = t.data();
  const core::LogDecisionFunction& support = guard.model().support();
  const bool reduced = guard.model().reduction() != nullptr;
  if (x.ndim() == 1 && !reduced) {
    return py::float_(support.Decision(NearestInt(steps[0]), Entries(x)));
  }
  py::array_t<double> g = NewVector(rows.rows());
  const std::span<double> values = Entries(g);
  {
    const py::gil_scoped_release unlocked;
    const core::Matrix reduced_rows = reduced ? guard.model().TaskStates(rows) : core::Matrix();
    const auto width = static_cast<std::size_t>(reduced ? reduced_rows.cols() : rows.cols());
    for (Eigen::Index i = 0; i < rows.rows(); ++i) {
      const double* const row = reduced ? reduced_rows.row(i).data() : rows.row(i).data();
      values[static_cast<std::size_t>(i)] =
          support.Decision(NearestInt(steps[shared ? 0 : i]), {row, width});
    }
  }
  if (x.ndim() == 1) return py::float_(values[0]);
  return g;
}

// None keeps a setting unchanged.
Guard With(const Guard& guard, const py::object& strategy, const py::object& horizon,
           const py::object& max_actions, const py::object& action_limit,
           const py::object& alarm_level, const py::object& direction_error,
           const py::object& demonstrated) {
  GuardSettings settings = guard.model().settings();
  const auto real = [](const py::object& value, const char* name, double& setting) {
    if (!value.is_none()) setting = RealOption(value, name);
  };
  const auto whole = [](const py::object& value, const char* name, int& setting) {
    if (!value.is_none()) setting = WholeOption(value, name);
  };
  if (!strategy.is_none()) {
    settings.strategy = safety::ParseStrategy(TextOption(strategy, "strategy"));
  }
  whole(horizon, "horizon", settings.horizon);
  whole(max_actions, "max_actions", settings.max_actions);
  if (!action_limit.is_none()) {
    settings.action_limit = RealsOption(action_limit, "action_limit");
  }
  real(alarm_level, "alarm_level", settings.alarm_level);
  real(direction_error, "direction_error", settings.direction_error);
  if (!demonstrated.is_none()) settings.demonstrated = FlagOption(demonstrated, "demonstrated");
  return Guard(guard.model().With(settings));
}

py::dict Certify(const Guard& guard, const py::object& t, const Array& state, const Array& action) {
  const safety::Certification found =
      guard.model().Certify(std::max(0, StepOf(t)), Entries(state), Entries(action));
  const auto entries = [](const Eigen::VectorXd& values) {
    return NewVector(static_cast<py::ssize_t>(values.size()), values.data());
  };
  py::dict result;
  result["passes"] = found.passes;
  result["step"] = found.step;
  result["margin"] = found.margin;
  result["radius"] = found.radius;
  result["ball_radius"] = found.ball_radius;
  result["shift"] = entries(found.shift);
  result["effect"] = entries(found.effect);
  return result;
}

Guard Copy(const Guard& guard) { return Guard(guard.model().With(guard.model().settings())); }

py::dict Summary(const Guard& guard) {
  const safety::GuardSummary& summary = guard.model().summary();
  py::dict values;
  values["source"] = summary.source;
  values["version"] = summary.version;
  values["demonstrations"] = summary.demonstrations;
  values["transitions"] = summary.transitions;
  values["nu"] = summary.nu;
  values["gamma"] = summary.gamma;
  values["acceptance"] = summary.acceptance;
  values["inside_throughout"] = summary.inside_throughout;
  values["false_alarms"] = summary.false_alarms;
  values["confidence"] = summary.confidence;
  values["held_out"] = summary.held_out;
  values["support_fits"] = summary.support_fits;
  values["drift_level"] = summary.drift_level;
  values["drift_chance"] = summary.drift_chance;
  values["gap_points"] = summary.gaps.points;
  values["gap_points_inside"] = summary.gaps.inside;
  values["direction_error"] = summary.direction_error.value;
  values["gain"] = summary.gain.value;
  values["coverage"] = summary.gain.coverage;
  values["changed"] = summary.changed;
  values["ends_outside"] = summary.ends_outside;
  values["explained"] = summary.explained;
  values["action_error"] = summary.action_error;
  py::list components;
  for (const reduction::ComponentsScore& row : summary.components) {
    py::dict score;
    score["components"] = row.components;
    score["explained"] = row.explained;
    score["inside"] = row.inside;
    score["response_error"] = row.response_error;
    components.append(std::move(score));
  }
  values["components"] = std::move(components);
  values["components_reason"] = summary.components_reason;
  values["warnings"] = safety::Warnings(guard.model());
  return values;
}

py::dict Settings(const Guard& guard) {
  const GuardSettings& settings = guard.model().settings();
  py::dict values;
  values["strategy"] = safety::Name(settings.strategy);
  values["horizon"] = settings.horizon;
  values["max_actions"] = settings.max_actions;
  values["action_limit"] = py::cast(settings.action_limit);
  values["alarm_level"] = settings.alarm_level;
  values["direction_error"] = settings.direction_error;
  values["demonstrated"] = settings.demonstrated;
  return values;
}

py::list Blocks(const Guard& guard) {
  py::list blocks;
  for (const auto& block : guard.model().layout().blocks) {
    const auto& [height, width, channels] = block.picture;
    blocks.append(py::make_tuple(block.name, height == 0
                                                 ? py::object(py::int_(block.size))
                                                 : py::make_tuple(height, width, channels)));
  }
  return blocks;
}

}  // namespace

void AddGuard(py::module_& module) {
  py::class_<Guard> guard_class(
      module, "Guard",
      R"(Run-time safety filter that keeps any policy near its demonstrations.

>>> guard = dfr.Guard.load("task.guard")                            # doctest: +SKIP
>>> guard.reset(seed=0)                                             # doctest: +SKIP
>>> action, info = guard.filter(t, state, policy(state))            # doctest: +SKIP

It estimates the response of states to actions online. Each call of `filter` therefore means that the
last returned action was applied, and that `state` is its result. It fails closed: on a state or action of
the wrong size or with a NaN, a `t` that is not the next one, or before `reset`, it halts, and all
actions are zero until `reset`. Zero must hold the robot still: actions are velocities or increments.

One object belongs to one thread. Copies and unpickled guards have the same models and settings, and
wait for `reset`.

Attributes
----------
state_dim, action_dim : int
num_steps : int
    Number of time steps with a separate estimate; later ones use the last.
layout : list of (str, int or (int, int, int))
    Name and size of each part of a state; of a picture its height, width and channels.
features : str
    Features of a state; empty for all entries.
settings : dict
    strategy, horizon, max_actions, action_limit, alarm_level, direction_error, demonstrated (whether nearby
    demonstrated actions may replace an action); `with_settings` changes them.
summary : dict
    Results of the fit, among them acceptance, the share of states of left-out demonstrations that are
    inside, and false_alarms, the share of further demonstrations that may raise an alarm. For the actions
    of left-out demonstrations: changed, the share that the guard would change; ends_outside, the share
    that is predicted to end outside; explained, the share of their variance that the features explain;
    action_error, the remaining squared error as a share of the squared actions. components: for each number
    of components that was tried, explained, inside and response_error, the relative squared error of the
    predicted change; components_reason: the reason of the choice. warnings: problems of the guard, each
    with its remedy.
)");
  PickleBy(
      guard_class, [](const py::object& self) { return ToBytes(self.cast<const Guard&>()); },
      &FromBytes);
  guard_class
      .def_static(
          "fit", &Fit, py::arg("states"), py::arg("actions"), py::kw_only(),
          py::arg("layout") = std::vector<std::pair<std::string, int>>(), py::arg("features") = "",
          py::arg("nu") = safety::GuardOptions().support.svm.nu,
          py::arg("gamma") = safety::GuardOptions().support.svm.gamma,
          py::arg("strategy") = "guard", py::arg("horizon") = 0, py::arg("action_limit") = 0.0,
          py::arg("false_alarms") = 0.1, py::arg("confidence") = 0.0, py::arg("hold_out") = 0.0,
          py::arg("error_factor") = safety::GuardOptions().error_factor, py::arg("source") = "",
          py::arg("differences") = false, py::arg("as_recorded") = false,
          py::arg("accept_any") = false, py::arg("progress") = py::none(),
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
    Features, as in "object,tip[0:2]"; all entries if empty. "obs/object" is "object".
    "points:image[:K][:grey][:HxW][:light=none|gain|standard]" stands for K slow features of the positions
    of patches in a picture, "pca:embedding[:K]" for K principal components of a block, "slow:embedding[:K]"
    for K slow features of these; without K the fit chooses their number. The other options are for
    pictures: one channel, the size after averaging, and the light, of which "standard" (the default)
    removes brightness and contrast, "gain" the brightness. docs/pixels.md has more.
nu, gamma : float
    Parameters of the supports; gamma in whitened units, which all tasks share. It is doubled at most twice
    if a support contains the gap between two modes.
strategy : {"guard", "controller", "dfr", "early-stopping", "monitor", "certified"}
    Source of the actions. "guard": the policy, whose action passes unchanged while it is predicted to end
    inside; at the boundary it is corrected. "controller": the demonstrations; the policy's action passes
    only deep inside. Use it for a policy that is known to be bad, or without one. "dfr": the policy, with
    Derivative-Free Recovery as published. "early-stopping": the policy, until a halt at the boundary.
    "monitor": the policy alone, with alarms. "certified": only actions that provably raise no alarm, under
    the assumptions of docs/certificates.md.
horizon : int
    Largest number of the policy's actions in an episode; 0: twice that of the longest demonstration.
action_limit : float or sequence of float
    Limit of the magnitude of each entry of an action, or of all entries; 0: 1.5 times the largest
    demonstrated value of each entry.
false_alarms : float
    Share of demonstrations that may raise an alarm.
confidence : float
    Confidence that this fit keeps false_alarms; 0: on average over fits.
hold_out : float
    Share of the demonstrations to leave out of the fit: the bounds of alarm and certificate are then
    exact. 0: none, the bounds are approximate.
error_factor : float
    For strategy "certified": factor by which the predicted response to actions may be less accurate than
    in demonstrations.
source : str
    Origin of the demonstrations, stored in the file.
differences : bool
    Convert actions that are target positions, actions[t, k] = states[t, j] or the one after it, to
    increments by subtracting states[t, j]. Subtract it from the policy's actions before `filter`, too.
as_recorded : bool
    Accept actions that look like target positions, which are refused otherwise.
accept_any : bool
    Accept a fit in which almost no state of left-out demonstrations is inside, or components that hold up
    their demonstrator, which is refused otherwise.
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
)")
      .def_static(
          "load",
          [](const std::filesystem::path& path) {
            RequireFile(path);
            const py::gil_scoped_release unlocked;
            return Guard::Load(path);
          },
          py::arg("path"), R"(Read a file written by `save`, the program `guard` or the C++ library.

Raises
------
FileNotFoundError
    If the file does not exist.
RuntimeError
    If the file is truncated, damaged, or of another version; the message names it.
)")
      .def(
          "save",
          [](const Guard& guard, const std::filesystem::path& path) {
            const py::gil_scoped_release unlocked;
            guard.model().Save(path);
          },
          py::arg("path"), "Write the guard to one file, exactly and with a checksum.")
      .def(
          "export_onnx",
          [](const Guard& guard, const std::filesystem::path& path) {
            const py::gil_scoped_release unlocked;
            safety::ExportOnnx(guard.model(), path);
          },
          py::arg("path"), R"(Write g of whole states as an ONNX file in double.

Its inputs are t (rows, int64) and x (rows, state_dim), its output g (rows).
)")
      // The model is immutable: copies share it.
      .def("__copy__", &Copy)
      .def(
          "__deepcopy__", [](const Guard& guard, const py::dict&) { return Copy(guard); },
          py::arg("memo"))
      .def(
          "reset",
          [](Guard& guard, const py::object& seed) {
            guard.Reset(seed.is_none() ? 0
                                       : Option<std::uint64_t>(
                                             seed, "seed", "a whole number from 0 to 2^64 - 1"));
          },
          py::arg("seed") = 0,
          "Start an episode. The seed determines all random choices; None is 0.")
      .def(
          "stop", [](Guard& guard) { guard.Stop(); }, "Halt: all actions are zero until `reset`.")
      .def("filter", &Filter, py::arg("t"), py::arg("state"), py::arg("action"),
           R"(Return the action to apply instead of `action`.

Parameters
----------
t : int
    0 in the first call after `reset`, one more in each.
state : array_like of shape (state_dim,)
action : array_like of shape (action_dim,)
    Action of the policy.

Returns
-------
action : ndarray of shape (action_dim,)
info : dict
    g : float or None, decision function at the time step `step`: positive inside the support.
    threshold : float or None, value of g from which the policy's action passes unchecked.
    mode : "policy", "probe", "recovery" or "halt".
    reason : "inside", "outside" (passed nevertheless), "changed", "demonstrations", "probe",
        "recovery", or the cause of a halt.
    source : str, source of the action: "policy", "policy-changed", "demonstrations", "probe", "recovery" (of
        Algorithm 1) or "halt".
    changed : bool, whether the action differs from the policy's.
    why : str, why the policy's action did not pass; "" if it passed.
    change : float, size of the change; an ordinary demonstrated action has length 1.
    certified : bool, whether the next state provably raises no alarm, under the assumptions of
        docs/certificates.md (strategy "certified").
    alarm : bool, whether the state is further outside than demonstrations are.
    alarm_step : int, the time step of the alarm: the one that the state fits best.
    step : int, the time step of the strategy, of g and of threshold.
    entry : str or None, for the reason "quaternion-invalid": the entries of the state, as "quat[0:4]".
)")
      .def("certify", &Certify, py::arg("t"), py::arg("state"), py::arg("action"),
           R"(Return the certificate of the state after `action`, for any strategy.

It holds under the assumptions of docs/certificates.md. It uses the response to actions estimated from
demonstrations (`filter` also learns from applied actions). Lengths are in whitened features.

Parameters
----------
t : int
    Time step of the demonstrations. Supports near it are used.
state : array_like of shape (state_dim,)
action : array_like of shape (action_dim,)

Returns
-------
dict
    passes : bool, whether the next state provably raises no alarm.
    step : int, the time step whose support certifies the state, or comes nearest to it.
    margin : float, l of the predicted state minus the required level.
    radius : float, largest change of the features that provably ends inside; negative outside.
    ball_radius, shift : radius of a ball inside the support, centred at the features + shift.
    effect : ndarray, predicted change of the features.

Raises
------
ValueError
    If the guard has no `direction_error`, or was fitted in single precision.
)")
      .def("decision", &Decision, py::arg("t"), py::arg("x"),
           R"(Return g at time step(s) `t`, of one state or of each row; positive inside.

Returns
-------
float or ndarray of shape (n,)
)")
      .def("with_settings", &With, py::kw_only(), py::arg("strategy") = py::none(),
           py::arg("horizon") = py::none(), py::arg("max_actions") = py::none(),
           py::arg("action_limit") = py::none(), py::arg("alarm_level") = py::none(),
           py::arg("direction_error") = py::none(), py::arg("demonstrated") = py::none(),
           "Return a guard with the same models and other settings.")
      .def_property_readonly("state_dim", &Guard::state_dim)
      .def_property_readonly("action_dim", &Guard::action_dim)
      .def_property_readonly("num_steps",
                             [](const Guard& guard) { return guard.model().num_steps(); })
      .def_property_readonly("layout", &Blocks, "Name and size of each part of a state.")
      .def_property_readonly(
          "features",
          [](const Guard& guard) { return guard.model().task().features().selection().spec(); },
          "Features of a state; empty for all entries.")
      .def_property_readonly("settings", &Settings)
      .def_property_readonly("summary", &Summary)
      .def("__repr__", [](const Guard& guard) {
        return "<dfr.Guard: " + std::to_string(guard.model().num_steps()) +
               " time steps, states of " + std::to_string(guard.state_dim()) +
               " entries, actions of " + std::to_string(guard.action_dim()) + ", " +
               safety::Name(guard.model().settings().strategy) + ">";
      });
  AddGuardAdvice(guard_class);
}

}  // namespace dfr::python
