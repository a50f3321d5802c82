#pragma once

#include <filesystem>
#include <stdexcept>

namespace dfr::imitation::internal {

/// Call this function before opening a dataset's file. Accepts a missing file.
/// @throws std::runtime_error for a folder, and for a pipe or a device, which could block forever.
inline void CheckPlainFile(const std::filesystem::path& path) {
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::status(path, error);
  if (!std::filesystem::exists(status) || std::filesystem::is_regular_file(status)) return;
  const bool folder = std::filesystem::is_directory(status);
  throw std::runtime_error(path.string() +
                           (folder ? ": is a folder" : ": is a pipe or a device, not a file"));
}

}  // namespace dfr::imitation::internal
