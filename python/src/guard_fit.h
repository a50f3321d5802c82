#pragma once

#include <pybind11/pybind11.h>

#include "dfr/safety/guard.h"

namespace dfr::python {

/// Adds dfr.Guard.fit: converts and checks its arguments, and reports progress and warnings.
void AddGuardFit(pybind11::class_<safety::Guard>& guard_class);

}  // namespace dfr::python
