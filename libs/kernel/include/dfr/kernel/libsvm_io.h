#pragma once

#include <filesystem>
#include <istream>
#include <string>

#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"

namespace dfr::kernel {

/// Writes a model file that LIBSVM's svm-predict loads: alpha and rho in LIBSVM's scale, every
/// number with 17 digits, so that its decision values are libsvm_scale() times ours to rounding.
/// Replaces the file only when all is written.
/// @throws std::runtime_error naming the file and what the system said.
void SaveLibsvmModel(const OneClassSvm& svm, const std::filesystem::path& path);

/// Reads a model file of LIBSVM (one_class, rbf). Its coefficients are scaled to sum to 1, so g is
/// LIBSVM's decision value divided by libsvm_scale().
/// @throws std::runtime_error naming file, line and reason where the file is missing, of another
///   kind, truncated, damaged or hostile (huge counts and indices are refused before anything is
///   allocated for them).
OneClassSvm LoadLibsvmModel(const std::filesystem::path& path);
/// The same from an open stream; `name` stands for the file in messages.
OneClassSvm LoadLibsvmModel(std::istream& in, const std::string& name);

/// Reads samples in LIBSVM's sparse form, "label 1:v 3:v ..." with 1-based ascending indices
/// (labels are ignored, absent entries zero), or as comma-separated values, one sample per line,
/// with an optional header line. Which of them is told from the first line. `state_dim` > 0 asks
/// for that many entries; sparse lines may then have fewer, never more.
/// @throws std::runtime_error naming file, line and reason. A file that is larger than the memory
///   that Linux has available is refused before it is read.
core::Matrix LoadSamples(const std::filesystem::path& path, int state_dim = 0);

}  // namespace dfr::kernel
