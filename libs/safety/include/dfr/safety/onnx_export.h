#pragma once

#include <filesystem>
#include <string>

#include "dfr/core/files/onnx_graph.h"
#include "dfr/safety/guard_model.h"

namespace dfr::safety {

/// @throws std::invalid_argument if features use a reduction or rotations that jump
/// (core::StateMap), which no format can represent.
void CheckExport(const GuardModel& model);

/// Writes g of a guard as an ONNX file, in double and from whole states: inputs `t` (rows, int64)
/// and `x` (rows x state_dim), output `g` (rows), within 1e-12 of GuardModel::support(). Times out
/// of range use the nearest estimate. A NaN in an entry that the guard uses gives NaN.
/// @throws std::runtime_error naming the file and the system's error; std::invalid_argument as
/// CheckExport() does.
void ExportOnnx(const GuardModel& model, const std::filesystem::path& path);

/// Appends the computation of g to a larger graph. @returns the name of g.
std::string AppendDecision(core::OnnxGraph& graph, const GuardModel& model, const std::string& t,
                           const std::string& x);

}  // namespace dfr::safety
