#include "dfr/imitation/demonstrations.h"

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "arrays.h"
#include "dfr/reduction/state_reduction.h"

namespace py = pybind11;

namespace dfr::python {
namespace {

// Passes the matrix's memory to NumPy.
py::array_t<double> ToArray(core::Matrix&& matrix) {
  auto* const owned = new core::Matrix(std::move(matrix));
  const py::capsule owner(owned, [](void* memory) { delete static_cast<core::Matrix*>(memory); });
  return py::array_t<double>({owned->rows(), owned->cols()}, owned->data(), owner);
}

// Returns (states, actions, layout, completed, environment, note), see _demonstrations.py.
py::tuple Load(const std::filesystem::path& path, const std::string& filter_key,
               const std::vector<std::string>& pictures) {
  RequireFile(path);
  std::vector<core::BlockRequest> requests;
  requests.reserve(pictures.size());
  for (const std::string& picture : pictures) {
    for (auto& request : reduction::StateReduction::Requests("pca:" + picture)) {
      requests.push_back(std::move(request));
    }
  }
  const auto reader = imitation::OpenDemonstrations(path, filter_key, requests);
  py::list states;
  py::list actions;
  py::list completed;
  // Keeps the interpreter's lock, because only one thread at a time may call libhdf5.
  for (int i = 0; i < reader->num_episodes(); ++i) {
    core::Trajectory episode = reader->Read(i);
    completed.append(episode.outcome == core::Outcome::kCompleted);
    states.append(ToArray(std::move(episode.states)));
    actions.append(ToArray(std::move(episode.controls)));
    if (PyErr_CheckSignals() != 0) throw py::error_already_set();
  }
  return py::make_tuple(states, actions, Blocks(reader->layout()), completed, reader->environment(),
                        reader->note());
}

}  // namespace

void AddDemonstrations(py::module_& module) {
  module.def("load_demonstrations", &Load, py::arg("path"), py::arg("filter_key"),
             py::arg("pictures"));
}

}  // namespace dfr::python
