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
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "arrays.h"
#include "dfr/core/contract.h"
#include "dfr/core/features/rotations.h"
#include "dfr/core/files/read_file.h"
#include "dfr/safety/guard_advice.h"
#include "dfr/safety/guard_model.h"
#include "dfr/safety/onnx_export.h"
#include "guard_advice.h"
#include "guard_fit.h"

namespace py = pybind11;

namespace dfr::python {
namespace {

using safety::Guard;
using safety::GuardSettings;
using safety::Verdict;

// Returns None instead of NaN, which is inconvenient to compare and log.
py::object Number(double value) {
  return std::isnan(value) ? py::object(py::none()) : py::object(py::float_(value));
}

// A temporary file, because a guard can be saved only to a path.
class TemporaryFile {
 public:
  TemporaryFile() {
    std::error_code error;
    folder_ = (std::filesystem::temp_directory_path(error) / "dfr-XXXXXX").string();
    if (error) {
      throw std::runtime_error(
          "there is no folder for temporary files: set TMPDIR to a folder that you may write to");
    }
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

// Converts a guard to the content of its file; inverse of FromBytes().
py::bytes ToBytes(const Guard& guard) {
  std::string content;
  {
    const Unlocked unlocked;
    const TemporaryFile file;
    guard.model().Save(file.path());
    content = core::ReadFile(file.path());
  }
  return py::bytes(content);
}

Guard FromBytes(const std::string& content) {
  const Unlocked unlocked;
  const TemporaryFile file;
  {
    std::ofstream out(file.path(), std::ios::binary);
    out.write(content.data(), static_cast<std::streamsize>(content.size()));
    out.close();
    if (!out) throw std::runtime_error(file.path().string() + ": cannot be written");
  }
  try {
    return Guard::Load(file.path());
  } catch (const std::runtime_error& e) {
    throw std::runtime_error("pickled guard" +
                             std::string(e.what()).substr(file.path().string().size()));
  }
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

py::object GuardDecision(const Guard& guard, const py::object& time, const Array& x) {
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
    const Unlocked unlocked;
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

// Returns a guard with other settings. None keeps a setting unchanged.
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
    // Only a fit has a default limit.
    if (settings.action_limit.empty()) settings.action_limit = {0.0};
  }
  real(alarm_level, "alarm_level", settings.alarm_level);
  real(direction_error, "direction_error", settings.direction_error);
  if (!demonstrated.is_none()) settings.demonstrated = FlagOption(demonstrated, "demonstrated");
  return Guard(guard.model().With(settings));
}

py::dict Certify(const Guard& guard, const py::object& t, const Array& state, const Array& action) {
  const safety::Certification found =
      guard.model().Certify(StepOrLast(t), Entries(state), Entries(action));
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

py::dict SummaryOf(const Guard& guard) {
  const safety::GuardSummary& summary = guard.model().summary();
  py::dict values;
  // A file's name can be any bytes. Python decodes it as in os.listdir().
  values["source"] = py::reinterpret_steal<py::str>(PyUnicode_DecodeFSDefaultAndSize(
      summary.source.data(), static_cast<Py_ssize_t>(summary.source.size())));
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

py::dict SettingsOf(const Guard& guard) {
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

}  // namespace

void AddGuard(py::module_& module) {
  py::class_<Guard> guard_class(
      module, "Guard",
      R"(Run-time safety filter that keeps a robot near the demonstrated states, around any policy.

>>> guard = dfr.Guard.load("task.guard")                            # doctest: +SKIP
>>> guard.reset(seed=0)                                             # doctest: +SKIP
>>> action, info = guard.filter(t, state, policy(state))            # doctest: +SKIP

It estimates the response of states to actions online. Each call of `filter` therefore means that the
last returned action was applied, and that `state` is its result. It fails closed: on a state or action of
the wrong size or with a NaN, a frozen sensor, a `t` that is not the next one, or before `reset`, it halts,
and all actions are zero until `reset`. Zero must hold the robot still: actions are velocities or increments.

One object belongs to one thread. Copies and unpickled guards have the same models and settings, and
wait for `reset`.

Attributes
----------
state_dim, action_dim : int
num_steps : int
    Number of time steps with a separate estimate; later time steps use the last estimate.
layout : list of (str, int or (int, int, int))
    Name and size of each part of a state; a picture's size is (height, width, channels).
features : str
    Features of a state; empty for all entries.
periods : ndarray of shape (state_dim,)
    Period of each entry of a state that is an angle with jumps; 0 for others.
settings : dict
    strategy, horizon, max_actions, action_limit, alarm_level, direction_error, demonstrated (True if nearby
    demonstrated actions may replace an action); `with_settings` changes them.
summary : dict
    Results of the fit, among them acceptance, the share of states of left-out demonstrations that are
    inside, and false_alarms, the share of further demonstrations that may raise an alarm. For the actions
    of left-out demonstrations: changed, the share that the guard would change; ends_outside, the share
    that is predicted to end outside; explained, the share of their variance that the features explain;
    action_error, the remaining squared error as a share of the squared actions. components: for each number
    of components that was tried, explained, inside and response_error, the relative squared error of the
    predicted change; components_reason: the reason for the choice. warnings: problems of the guard, each
    with its remedy.
)");
  PickleBy(
      guard_class, [](const py::object& self) { return ToBytes(self.cast<const Guard&>()); },
      &FromBytes);
  guard_class
      .def_static(
          "load",
          [](const std::filesystem::path& path) {
            RequireFile(path);
            const Unlocked unlocked;
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
            const Unlocked unlocked;
            guard.model().Save(path);
          },
          py::arg("path"), "Write the guard to one file, exactly and with a checksum.")
      .def(
          "export_onnx",
          [](const Guard& guard, const std::filesystem::path& path) {
            const Unlocked unlocked;
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
          "Start an episode. The seed determines all random choices; None means 0.")
      .def(
          "stop", [](Guard& guard) { guard.Stop(); }, "Halt: all actions are zero until `reset`.")
      .def("filter", &Filter, py::arg("t"), py::arg("state"), py::arg("action"),
           R"(Return the action to apply instead of `action`.

Parameters
----------
t : int
    0 in the first call after `reset`, increased by one with each call.
state : array_like of shape (state_dim,)
action : array_like of shape (action_dim,)

Returns
-------
action : ndarray of shape (action_dim,)
info : dict
    g : float or None, decision function at the time step `step`: positive inside the support.
    threshold : float or None, value of g, or of the predicted g, at which the policy's action passes.
    mode : "policy", "probe", "recovery" or "halt".
    reason : "inside", "outside" (passed although outside), "changed", "demonstrations", "probe",
        "recovery", or the cause of a halt.
    source : "policy", "policy-changed", "demonstrations", "probe", "recovery" (Algorithm 1) or "halt".
    changed : bool, whether the action differs from the policy's.
    why : str, why the policy's action did not pass; "" if it passed.
    change : float or None, size of the change; an ordinary demonstrated action has length 1.
    certified : bool, whether the next state provably raises no alarm (see docs/certificates.md).
    alarm : bool, whether the state is below the alarm level, invalid, unlike all demonstrations, or frozen.
    alarm_step : int, the time step of the alarm: the nearby time step whose support fits the state best.
    step : int, the time step of the strategy, of g and of threshold.
    entry : str or None, the invalid entries if the reason is "quaternion-invalid", as "quat[0:4]".
)")
      .def("certify", &Certify, py::arg("t"), py::arg("state"), py::arg("action"),
           R"(Return the certificate of the state after `action`, for any strategy.

The certificate holds under the assumptions of docs/certificates.md. It uses the response to actions
estimated from demonstrations (`filter` also learns from applied actions). Lengths are in whitened features.

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
    step : int, the time step whose support certifies the state, or comes nearest to doing so.
    margin : float, l of the predicted state minus the required level.
    radius : float, largest change of the features that provably ends inside; negative outside.
    ball_radius, shift : radius of a ball inside the support, centred on the features + shift.
    effect : ndarray, predicted change of the features.

Raises
------
ValueError
    If the guard has no `direction_error`, or was fitted in single precision.
)")
      .def("decision", &GuardDecision, py::arg("t"), py::arg("x"),
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
      .def_property_readonly(
          "layout", [](const Guard& guard) { return Blocks(guard.model().layout()); },
          "Name and size of each part of a state.")
      .def_property_readonly(
          "features",
          [](const Guard& guard) { return guard.model().task().features().selection().spec(); },
          "Features of a state; empty for all entries.")
      .def_property_readonly("settings", &SettingsOf)
      .def_property_readonly("summary", &SummaryOf)
      .def("__repr__", [](const Guard& guard) {
        return "<dfr.Guard: " + std::to_string(guard.model().num_steps()) +
               " time steps, states of " + std::to_string(guard.state_dim()) +
               " entries, actions of " + std::to_string(guard.action_dim()) + ", " +
               safety::Name(guard.model().settings().strategy) + ">";
      });
  AddGuardFit(guard_class);
  AddGuardAdvice(guard_class);
}

}  // namespace dfr::python
