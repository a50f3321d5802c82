#include <pybind11/pybind11.h>

#include <exception>
#include <stdexcept>
#include <string_view>

#include "arrays.h"
#include "dfr/core/build_info.h"

namespace py = pybind11;

namespace {

// Raises a Python error. Escapes bytes that are not UTF-8, which a message may quote from a file or
// its name: Python would show an empty string instead.
void Raise(PyObject* type, std::string_view text) {
  const auto message = py::reinterpret_steal<py::object>(
      PyUnicode_DecodeUTF8(text.data(), std::ssize(text), "backslashreplace"));
  if (message) PyErr_SetObject(type, message.ptr());
}

void RaiseErrorsOfLibrary(std::exception_ptr thrown) {
  try {
    std::rethrow_exception(thrown);
  } catch (const py::builtin_exception&) {
    throw;  // pybind11's own runtime errors keep their Python types
  } catch (const std::invalid_argument& e) {
    Raise(PyExc_ValueError, e.what());
  } catch (const std::runtime_error& e) {
    Raise(PyExc_RuntimeError, e.what());
  }
}

}  // namespace

PYBIND11_MODULE(_core, module) {
  py::register_local_exception_translator(&RaiseErrorsOfLibrary);
  module.doc() = "The compiled part of dfr.";
  module.attr("__version__") = dfr::core::BuildVersion();
  module.attr("build_commit") = dfr::core::BuildCommit();
  dfr::python::AddSupportEstimate(module);
  dfr::python::AddTimeVaryingSupport(module);
  dfr::python::AddGuard(module);
#ifdef DFR_PYTHON_DEMONSTRATIONS
  dfr::python::AddDemonstrations(module);
#endif
#ifdef DFR_PYTHON_EXPERIMENT
  dfr::python::AddExperiment(module);
#endif
}
