#pragma once

#include <filesystem>
#include <string>

#include "dfr/core/onnx_graph.h"
#include "dfr/kernel/one_class_svm.h"
#include "dfr/kernel/time_varying_support.h"
#include "dfr/kernel/whitened_support.h"

namespace dfr::kernel {

// g as an ONNX file, in double: within 1e-12 of Decision(). A state with a NaN gives NaN there, for
// which no comparison holds, instead of -infinity.

/// Input `x` (rows x state_dim), output `g` (rows).
/// @throws std::runtime_error naming the file and what the system said.
void ExportOnnx(const OneClassSvm& svm, const std::filesystem::path& path);

/// Inputs `t` (rows, int64) and `x` (rows x state_dim), output `g` (rows). Times out of range use
/// the nearest estimate. All estimates are padded to the largest one.
void ExportOnnx(const TimeVaryingSupport& support, const std::filesystem::path& path);

/// The same as a part of a larger graph: the names of the inputs lead to that of g.
std::string AppendDecision(core::OnnxGraph& graph, const OneClassSvm& svm, const std::string& x);
std::string AppendDecision(core::OnnxGraph& graph, const TimeVaryingSupport& support,
                           const std::string& t, const std::string& x);
/// The same for a whitened support: takes features z and applies the map of each time step.
std::string AppendDecision(core::OnnxGraph& graph, const WhitenedSupport& support,
                           const std::string& t, const std::string& z);

}  // namespace dfr::kernel
