#pragma once

#include <filesystem>
#include <istream>
#include <string>

namespace dfr::core {

/// Call this function before opening a file. Accepts a missing file.
/// @throws std::runtime_error naming `path`, for a folder, and for a pipe or a device, which could
///   block forever.
void CheckPlainFile(const std::filesystem::path& path);

/// Appends the rest of `in`, a stream of the file `path`, to `bytes`. A disk failure in the middle
/// of the file is an error: the result is never a part of the file.
/// @throws std::runtime_error naming `path` if `in` cannot be read or does not fit into memory.
void AppendRest(std::istream& in, const std::filesystem::path& path, std::string& bytes);

/// Returns the content of a file that CheckPlainFile() accepts.
/// @throws std::runtime_error naming `path` and the problem.
[[nodiscard]] std::string ReadFile(const std::filesystem::path& path);

}  // namespace dfr::core
