#pragma once

#include <pybind11/pybind11.h>

#include "dfr/safety/guard.h"

namespace dfr::python {

/// dfr.Guard.fit: its arguments are converted and checked, and progress and warnings are reported.
void AddGuardFit(pybind11::class_<safety::Guard>& guard_class);

}  // namespace dfr::python
