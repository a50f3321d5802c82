#pragma once

#include <filesystem>
#include <istream>
#include <string>

#include "dfr/kernel/one_class_svm.h"

namespace dfr::kernel {

/// Writes a model file for LIBSVM's svm-predict: alpha and rho in LIBSVM's scale, with 17 digits.
/// LIBSVM's decision values are libsvm_scale() times g, up to rounding. Replaces the file only once
/// all is written.
/// @throws std::runtime_error with the file and the system's message.
void SaveLibsvmModel(const OneClassSvm& svm, const std::filesystem::path& path);

/// Reads a LIBSVM model file (one_class, rbf). Scales its coefficients to sum to 1: g is LIBSVM's
/// decision value divided by libsvm_scale().
/// @throws std::runtime_error with file, line and reason if the file is missing, of another kind,
///   truncated, damaged or hostile. Rejects huge counts and indices before allocating memory for
///   them.
OneClassSvm LoadLibsvmModel(const std::filesystem::path& path);
/// Reads from an open stream; messages call it `name`.
OneClassSvm LoadLibsvmModel(std::istream& in, const std::string& name);

}  // namespace dfr::kernel
