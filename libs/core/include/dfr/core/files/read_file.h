#pragma once

#include <filesystem>
#include <istream>
#include <string>

namespace dfr::core {

/// Checks a path before a file is opened for reading. Accepts a missing file.
/// @throws std::runtime_error naming `path` if it is a folder, a pipe or a device. A pipe or a
///   device could block forever.
void CheckPlainFile(const std::filesystem::path& path);

/// Appends the rest of `in`, a stream of the file `path`, to `bytes`. A disk failure in the middle
/// of the file is an error: the result never holds only a part of the file.
/// @throws std::runtime_error naming `path` if `in` cannot be read or does not fit into memory.
void AppendRest(std::istream& in, const std::filesystem::path& path, std::string& bytes);

/// Returns the content of a file that CheckPlainFile() accepts.
/// @throws std::runtime_error naming `path` and the problem.
[[nodiscard]] std::string ReadFile(const std::filesystem::path& path);

}  // namespace dfr::core
