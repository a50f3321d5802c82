#include <pybind11/pybind11.h>

#include "arrays.h"
#include "dfr/core/build_info.h"

PYBIND11_MODULE(_core, module) {
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
