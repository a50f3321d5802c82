// The simulated Pusher for pusher_guard_test.py, in place of a robot's driver.
#include "dfr/sim/pusher/pusher_plant.h"

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <string>
#include <vector>

namespace py = pybind11;

namespace {

using dfr::sim::PusherPlant;
using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;

py::array_t<double> Observe(const PusherPlant& plant) {
  py::array_t<double> state(plant.state_dim());
  plant.Observe({state.mutable_data(), static_cast<std::size_t>(state.size())});
  return state;
}

}  // namespace

PYBIND11_MODULE(pusher_plant, module) {
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
