#pragma once

#include <filesystem>
#include <istream>
#include <string>

namespace dfr::core {

/// Call this function before opening a file. Accepts a missing file.
/// @throws std::runtime_error naming `path`, for a folder, and for a pipe or a device, which could
///   block forever.
void CheckPlainFile(const std::filesystem::path& path);

/// Appends to `bytes` what `in`, a stream of the file `path`, has left. A file whose disk fails in
/// the middle is an error, not a shorter file.
/// @throws std::runtime_error naming `path` if `in` cannot be read or does not fit into memory.
void AppendRest(std::istream& in, const std::filesystem::path& path, std::string& bytes);

/// Returns the content of a file that CheckPlainFile() accepts.
/// @throws std::runtime_error naming `path` and the problem.
[[nodiscard]] std::string ReadFile(const std::filesystem::path& path);

}  // namespace dfr::core
