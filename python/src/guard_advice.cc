#include "guard_advice.h"

#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "arrays.h"
#include "dfr/core/contract.h"
#include "dfr/core/features/absolute_actions.h"
#include "dfr/safety/guard_advice.h"

namespace py = pybind11;

namespace dfr::python {
namespace {

using control::HaltCause;
using safety::Guard;

// Returns the number of leading actions that may be played.
int FilterChunk(Guard& guard, const py::object& t, const Array& state, const Array& actions) {
  DFR_THROW_UNLESS(
      state.size() == guard.state_dim(),
      "the state has " << state.size() << " entries; the guard needs " << guard.state_dim());
  DFR_THROW_UNLESS(actions.ndim() == 2, "a chunk has 2 dimensions, (k, "
                                            << guard.action_dim() << "), not " << actions.ndim());
  DFR_THROW_UNLESS(actions.shape(0) > 0, "the chunk has no actions");
  DFR_THROW_UNLESS(actions.shape(1) == guard.action_dim(),
                   "the actions of the chunk have "
                       << actions.shape(1) << " entries; the guard needs " << guard.action_dim());
  for (py::ssize_t i = 0; i < state.size(); ++i) {
    DFR_THROW_UNLESS(std::isfinite(state.data()[i]), core::EntryName(guard.model().layout(), i)
                                                         << " of the state is " << state.data()[i]);
  }
  for (py::ssize_t i = 0; i < actions.size(); ++i) {
    DFR_THROW_UNLESS(std::isfinite(actions.data()[i]),
                     "entry " << i % actions.shape(1) << " of action " << i / actions.shape(1)
                              << " is " << actions.data()[i]);
  }
  const int step = StepOf(t);
  const safety::ChunkVerdict verdict = guard.FilterChunk(step, Entries(state), Entries(actions));
  if (verdict.halted) return 0;
  DFR_THROW_UNLESS(verdict.cause != HaltCause::kStepSkipped,
                   "t is " << py::str(t).cast<std::string>()
                           << ", but the next call of filter has t = " << guard.next_step());
  if (verdict.cause != HaltCause::kNone) return 0;
  DFR_THROW_UNLESS(verdict.judged > 0,
                   "strategy '" << safety::Name(guard.model().settings().strategy)
                                << "' predicts nothing: filter each action, or use strategy "
                                   "'guard', 'controller' or 'monitor'");
  return verdict.playable;
}

void Applied(Guard& guard, const Array& action) {
  DFR_THROW_UNLESS(
      action.size() == guard.action_dim(),
      "the action has " << action.size() << " entries; the guard needs " << guard.action_dim());
  for (py::ssize_t i = 0; i < action.size(); ++i) {
    DFR_THROW_UNLESS(std::isfinite(action.data()[i]),
                     "entry " << i << " of the action is " << action.data()[i]);
  }
  guard.Applied(Entries(action));
}

// Returns the time step at which l of the state is largest.
int BestStep(const Guard& guard, std::span<const double> state) {
  int best = 0;
  double highest = -std::numeric_limits<double>::infinity();
  for (int t = 0; t < guard.model().num_steps(); ++t) {
    const double l = guard.model().support().LogDecision(t, state, {});
    if (l > highest) {
      highest = l;
      best = t;
    }
  }
  return best;
}

py::dict Explain(const Guard& guard, const Array& state, const py::object& t,
                 const Arrays& demonstrations) {
  DFR_THROW_UNLESS(
      state.size() == guard.state_dim(),
      "the state has " << state.size() << " entries; the guard needs " << guard.state_dim());
  for (py::ssize_t i = 0; i < state.size(); ++i) {
    DFR_THROW_UNLESS(std::isfinite(state.data()[i]),
                     "entry " << i << " of the state is " << state.data()[i]);
  }
  const safety::GuardModel& model = guard.model();
  const std::span<const double> x = Entries(state);
  const core::Matrix task_state = model.TaskStates(core::AsVector(x).transpose());
  const std::span<const double> seen = core::Row(task_state, 0);
  const int asked = t.is_none() ? -1 : StepOrLast(t);
  const int step = t.is_none() ? BestStep(guard, seen) : std::min(asked, model.num_steps() - 1);
  const std::vector<safety::OutsideEntry> outside = safety::OutsideEntries(model, step, x);
  const double l = model.support().LogDecision(step, seen, {});
  std::string text = safety::Describe(model, step, outside);
  if (outside.empty()) {
    text = (l >= 0.0 ? "inside what was demonstrated at step "
                     : "immeasurably far outside what was demonstrated at step ") +
           std::to_string(step);
  }
  py::list entries;
  for (const safety::OutsideEntry& one : outside) {
    py::dict entry;
    entry["name"] = core::EntryName(model.task_layout(), one.entry);
    entry["entry"] = one.entry;
    entry["excess"] = one.excess;
    entry["share"] = one.share;
    entries.append(std::move(entry));
  }
  py::object nearest = py::none();
  std::vector<core::Matrix> states;
  for (const Array& one : demonstrations.each) {
    DFR_THROW_UNLESS(one.ndim() == 2, "demonstration " << states.size()
                                                       << " must have 2 dimensions, not "
                                                       << one.ndim());
    states.push_back(Rows(one, "demonstrations"));
  }
  const safety::NearestDemonstration found = safety::Nearest(model, asked, x, states);
  if (found.demonstration >= 0) {
    py::dict values;
    values["demonstration"] = found.demonstration;
    values["step"] = found.step;
    values["distance"] = found.distance;
    nearest = std::move(values);
    text += "; demonstration " + std::to_string(found.demonstration) + " comes nearest, at step " +
            std::to_string(found.step);
  }
  py::dict result;
  result["text"] = text;
  result["l"] = l;
  result["step"] = step;
  result["entries"] = std::move(entries);
  result["nearest"] = std::move(nearest);
  return result;
}

}  // namespace

int StepOf(const py::object& t) {
  const std::int64_t value = WholeStep(t);
  return value == NearestInt(value) ? static_cast<int>(value) : -1;
}

int StepOrLast(const py::object& t) {
  const std::int64_t value = WholeStep(t);
  CheckStep(value);
  return NearestInt(value);
}

void AddGuardAdvice(py::class_<Guard>& guard_class) {
  guard_class
      .def("applied", &Applied, py::arg("action"),
           R"(Report that `action` was applied instead of the result of the last `filter`.

Call it before the next `filter`; the last report counts. If the robot limits actions itself, report the limited action. If the
robot always applies the policy's own action, the guard runs in shadow: it judges actions but changes none.

Strategies "dfr", "early-stopping" and "certified" halt if `action` is not the one that `filter` returned.
A guard halts if `filter` has not been called since `reset`. Unless it only monitors, it also halts if a
steered entry is beyond both its limit and five times its largest demonstrated value, as in wrong units.

Raises
------
ValueError
    If the action has the wrong number of entries or a non-finite entry.
)")
      .def("filter_chunk", &FilterChunk, py::arg("t"), py::arg("state"), py::arg("actions"),
           R"(Return the number of a chunk's leading actions that are predicted to be safe.

An action counts if it is within the limits and predicted to end inside, at the level at which
`filter` passes it. Counting stops at the first action that does not count. A monitor counts actions
within the limits and the horizon. The guard is not changed.

Pass each counted action to `filter` with the state that was reached, because predictions can be wrong
and `filter` decides. After the last of them, or after the first action that `filter` changes, ask the
policy for a new chunk. If no action counts, pass the first action to `filter`, which returns a replacement.

Parameters
----------
t : int
    Number of the next call of `filter`.
state : array_like of shape (state_dim,)
actions : array_like of shape (k, action_dim)
    The first 256 are evaluated.

Returns
-------
int
    From 0 to k; 0 if the guard has halted or would halt at `state`.

Raises
------
ValueError
    If a shape is wrong, an entry is not finite, `t` is not the next one, or the strategy predicts
    nothing ("dfr", "early-stopping", "certified").
)")
      .def("explain", &Explain, py::arg("state"), py::kw_only(), py::arg("t") = py::none(),
           py::arg("demonstrations") = py::tuple(),
           R"(Explain which entries of a state are outside, how far, and at which time step.

Do not call this in a control loop. `filter` returns why an action did not pass, as info["why"].

Parameters
----------
state : array_like of shape (state_dim,)
t : int, optional
    Time step of the demonstrations to compare with; default: the time step that fits best.
demonstrations : iterable of array_like of shape (n_states_i, state_dim), optional
    Demonstrations in which to find the nearest state, at time steps near `t`.

Returns
-------
dict
    text : str, the explanation in one sentence.
    l : float, the log form of g; negative outside.
    step : int, the time step.
    entries : list of dict with name, entry, excess (distance of the entry above the
        demonstrated range, negative below, in its unit) and share (its part of -l). The largest share
        comes first. Empty inside.
    nearest : dict with demonstration, step and distance (in whitened features), or None.

Raises
------
ValueError
    If the state or a demonstration has the wrong number of entries, or an entry of the state is not finite.
)")
      .def(
          "reconstruct",
          [](const Guard& guard, const std::string& block, const Array& state) {
            const reduction::StateReduction* const reduction = guard.model().reduction();
            DFR_THROW_UNLESS(reduction != nullptr,
                             "the guard has no reduced block: its features have no pca: or slow:");
            const auto seen = reduction->Reconstruct(block, Entries(state));
            const auto& [height, width, channels] = seen.shape;
            using Shape = std::vector<py::ssize_t>;
            return py::array_t<double>(
                height == 0 ? Shape{std::ssize(seen.values)} : Shape{height, width, channels},
                seen.values.data());
          },
          py::arg("block"), py::arg("state"),
          R"(Return the block behind a feature "pca:" or "slow:", reconstructed from its components.

A picture has the size, channels and light that the options of its feature give it.

Parameters
----------
block : str
    Name of the block in `layout`, without the prefix.
state : array_like of shape (state_dim,)

Returns
-------
ndarray of shape (height, width, channels), or (n_entries,)

Raises
------
ValueError
    If there is no such block, its feature is "points:", or the state is not valid.
)")
      .def(
          "levels",
          [](const Guard& guard, const Array& states) {
            DFR_THROW_UNLESS(states.ndim() == 2,
                             "states must have 2 dimensions, not " << states.ndim());
            const core::Matrix rows = Rows(states, "states");
            std::vector<double> levels;
            {
              const Unlocked unlocked;
              levels = guard.model().Levels(rows);
            }
            return NewVector(static_cast<py::ssize_t>(levels.size()), levels.data());
          },
          py::arg("states"),
          R"(Return l, the log form of g, for each state of an episode, at the nearby time step that fits it best.

An alarm is raised if l < -settings["alarm_level"].

Returns
-------
ndarray of shape (n_states,)
)")
      .def(
          "attribution",
          [](const Guard& guard, const Array& states) {
            DFR_THROW_UNLESS(states.ndim() == 2, "states must have 2 dimensions");
            const core::Matrix rows = Rows(states, "states");
            core::Matrix attribution;
            {
              const Unlocked unlocked;
              attribution = safety::Attribution(guard.model(), rows);
            }
            return py::array_t<double>({attribution.rows(), attribution.cols()},
                                       attribution.data());
          },
          py::arg("states"),
          R"(Return the contribution of each entry of each state to -l.

Each row sums to -l of `levels`. It is zero if -l is not positive, and NaN if -l is infinite. An entry's
contribution is the rise of l due to this entry on the path back inside, independent of units. A negative
contribution compensates for others. For a block behind "pca:" or "slow:", contributions are those of its
own entries, such as pixels, along a path in the space of its components. For a block behind "points:",
they are at the pixels of the points that are outside.

Returns
-------
ndarray of shape (n_states, state_dim)
)")
      .def_property_readonly("periods", [](const Guard& guard) {
        const std::vector<double> periods = guard.model().Periods();
        return NewVector(std::ssize(periods), periods.data());
      });
}

}  // namespace dfr::python
