#pragma once

#include <filesystem>
#include <string>

#include "dfr/core/files/onnx_graph.h"
#include "dfr/imitation/mlp_policy.h"

namespace dfr::imitation {

/// Writes a policy as an ONNX file, in double: input `x` (rows x state_dim), the whole state;
/// output `u` (rows x control_dim), within 1e-12 of Control(). The graph includes features,
/// whitening and control limits. For a non-finite state, Control() gives NaN in all entries; an
/// ONNX runtime may give numbers.
/// @throws std::runtime_error naming the file and the system's message.
void ExportOnnx(const MlpPolicy& policy, const std::filesystem::path& path);

/// Appends the policy to a larger graph. Takes the name of x and returns the name of u.
std::string AppendControl(core::OnnxGraph& graph, const MlpPolicy& policy, const std::string& x);

}  // namespace dfr::imitation
