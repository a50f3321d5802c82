#pragma once

#include <filesystem>
#include <string>

#include "dfr/core/onnx_graph.h"
#include "dfr/safety/guard_model.h"

namespace dfr::safety {

/// @throws std::invalid_argument if features are made of rotations that jump (core::StateMap),
/// which
///   none of the formats can say.
void CheckExport(const GuardModel& model);

/// g of a guard as an ONNX file, in double and from whole states: inputs `t` (rows, int64) and `x`
/// (rows x state_dim), output `g` (rows), within 1e-12 of GuardModel::support(). Times out of range
/// use the nearest estimate. A NaN that the guard looks at gives NaN.
/// @throws std::runtime_error naming the file and what the system said, std::invalid_argument as
///   CheckExport().
void ExportOnnx(const GuardModel& model, const std::filesystem::path& path);

/// The same as a part of a larger graph: the names of the inputs lead to that of g.
std::string AppendDecision(core::OnnxGraph& graph, const GuardModel& model, const std::string& t,
                           const std::string& x);

}  // namespace dfr::safety
