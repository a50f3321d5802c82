#pragma once

#include <filesystem>
#include <istream>
#include <string>

#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"

namespace dfr::kernel {

/// Writes a model file for LIBSVM's svm-predict: alpha and rho in LIBSVM's scale, with 17 digits.
/// LIBSVM's decision values are libsvm_scale() times g, up to rounding. Replaces the file
/// atomically (core::AtomicFile).
/// @throws std::runtime_error naming the file and the system's message.
void SaveLibsvmModel(const OneClassSvm& svm, const std::filesystem::path& path);

/// Reads a LIBSVM model file (one_class, rbf). Scales its coefficients to sum to 1: g is LIBSVM's
/// decision value divided by libsvm_scale().
/// @throws std::runtime_error naming file, line and reason if the file is missing, of another kind,
///   truncated, damaged or hostile. Rejects huge counts and indices before allocating memory for
///   them.
OneClassSvm LoadLibsvmModel(const std::filesystem::path& path);
/// Overload for an open stream; messages call the stream `name`.
OneClassSvm LoadLibsvmModel(std::istream& in, const std::string& name);

/// Reads samples, one per line, in LIBSVM's sparse format or as comma-separated values with an
/// optional header line. The sparse format is "label 1:v 3:v ..." with ascending indices from 1;
/// labels are ignored; missing entries are zero. The first line with a comma or a colon determines
/// the format. If `state_dim` > 0, samples must have that many entries; sparse lines may have
/// fewer.
/// @throws std::runtime_error naming file, line and reason. On Linux, rejects a file larger than
///   the available memory before reading it.
core::Matrix LoadSamples(const std::filesystem::path& path, int state_dim = 0);

}  // namespace dfr::kernel
