#pragma once

#include <filesystem>
#include <string>

#include "dfr/core/files/onnx_graph.h"
#include "dfr/kernel/one_class_svm.h"
#include "dfr/kernel/time_varying_support.h"
#include "dfr/kernel/whitened_support.h"

namespace dfr::kernel {

// Export of g to an ONNX file, in double, within 1e-12 of Decision(). A state with a NaN gives NaN
// instead of -infinity. Every comparison with NaN is false.

/// Writes a graph with input `x` (rows x state_dim) and output `g` (rows).
/// @throws std::runtime_error naming the file and the system's message.
void ExportOnnx(const OneClassSvm& svm, const std::filesystem::path& path);

/// Writes a graph with inputs `t` (rows, int64) and `x` (rows x state_dim) and output `g` (rows).
/// Times out of range use the nearest estimate. Pads all estimates to the same number of support
/// vectors.
void ExportOnnx(const TimeVaryingSupport& support, const std::filesystem::path& path);

/// Appends the computation to a larger graph. Takes the names of the inputs and returns the name of
/// g.
std::string AppendDecision(core::OnnxGraph& graph, const OneClassSvm& svm, const std::string& x);
std::string AppendDecision(core::OnnxGraph& graph, const TimeVaryingSupport& support,
                           const std::string& t, const std::string& x);
/// Overload for a whitened support: takes features z and applies the map of each time step.
std::string AppendDecision(core::OnnxGraph& graph, const WhitenedSupport& support,
                           const std::string& t, const std::string& z);

}  // namespace dfr::kernel
