#pragma once

#include <pybind11/pybind11.h>

#include "dfr/safety/guard.h"

namespace dfr::python {

/// Converts an index to a time step. Integers beyond the range of int become -1, which is never the
/// next time step. @throws pybind11::error_already_set if `t` is not an index.
[[nodiscard]] int StepOf(const pybind11::object& t);
/// Converts the number of a time step; a number beyond the range of int becomes the largest int.
/// @throws std::invalid_argument if it is negative.
[[nodiscard]] int StepOrLast(const pybind11::object& t);

/// Adds applied, filter_chunk, explain, reconstruct, levels and attribution to dfr.Guard.
void AddGuardAdvice(pybind11::class_<safety::Guard>& guard_class);

}  // namespace dfr::python
