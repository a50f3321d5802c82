// For pusher_guard_test.py: the simulated Pusher in place of a robot's driver, and guarded episodes
// in C++.
#include "dfr/sim/pusher/pusher_plant.h"

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstdint>
#include <string>
#include <tuple>
#include <vector>

#include "dfr/core/trajectory.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_model.h"

namespace py = pybind11;

namespace {

using dfr::sim::PusherPlant;
using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;

py::array_t<double> Observe(const PusherPlant& plant) {
  py::array_t<double> state(plant.state_dim());
  plant.Observe({state.mutable_data(), static_cast<std::size_t>(state.size())});
  return state;
}

// Runs u = b + W x with a guard from the start state of `seed`. Each row of `weights` has an entry
// of b, then a row of W. Returns the outcome, the number of controls and the last state.
std::tuple<std::string, int, py::array_t<double>> Rollout(const std::string& guard_file,
                                                          const Array& weights,
                                                          std::uint64_t seed) {
  PusherPlant plant;
  dfr::safety::Guard guard(dfr::safety::GuardModel::Load(guard_file));
  plant.Reset(seed);
  guard.Reset(seed);
  std::vector<double> x(static_cast<std::size_t>(plant.state_dim()));
  std::vector<double> u(static_cast<std::size_t>(plant.control_dim()));
  int t = 0;
  for (; !plant.completed() && !plant.collided(); ++t) {
    plant.Observe(x);
    for (std::size_t i = 0; i < u.size(); ++i) {
      u[i] = weights.at(i, 0);
      for (std::size_t k = 0; k < x.size(); ++k) u[i] += weights.at(i, k + 1) * x[k];
    }
    if (guard.Filter(t, x, u, u).mode == dfr::control::Mode::kHalt) break;
    if (plant.Apply(u) != dfr::core::PlantStatus::kOk) break;
  }
  const auto outcome = plant.collided()    ? dfr::core::Outcome::kCollided
                       : plant.completed() ? dfr::core::Outcome::kCompleted
                                           : dfr::core::Outcome::kHalted;
  return {Name(outcome), t, Observe(plant)};
}

}  // namespace

PYBIND11_MODULE(pusher_plant, module) {
  module.def("rollout", &Rollout);
  py::class_<PusherPlant>(module, "PusherPlant")
      .def(py::init<>())
      .def("reset", &PusherPlant::Reset)
      .def("apply",
           [](PusherPlant& plant, const Array& control) {
             return plant.Apply({control.data(), static_cast<std::size_t>(control.size())}) ==
                    dfr::core::PlantStatus::kOk;
           })
      .def("observe", &Observe)
      .def_property_readonly("completed", &PusherPlant::completed)
      .def_property_readonly("collided", &PusherPlant::collided);
}
