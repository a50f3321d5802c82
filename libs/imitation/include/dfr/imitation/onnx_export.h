#pragma once

#include <filesystem>
#include <string>

#include "dfr/core/onnx_graph.h"
#include "dfr/imitation/mlp_policy.h"

namespace dfr::imitation {

/// A policy as an ONNX file, in double: input `x` (rows x state_dim), the whole state; output `u`
/// (rows x control_dim), within 1e-12 of Control(). Features, whitening and the control's limits
/// are inside. Control() answers a non-finite state by NaN throughout; an ONNX runtime need not.
/// @throws std::runtime_error naming the file and what the system said.
void ExportOnnx(const MlpPolicy& policy, const std::filesystem::path& path);

/// The same as a part of a larger graph: the name of x leads to that of u.
std::string AppendControl(core::OnnxGraph& graph, const MlpPolicy& policy, const std::string& x);

}  // namespace dfr::imitation
