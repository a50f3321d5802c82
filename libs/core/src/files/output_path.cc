#include "dfr/core/files/output_path.h"

#include <stdexcept>
#include <system_error>

#include "dfr/core/files/atomic_file.h"

namespace dfr::core {
namespace {

// Describes why `folder`, a part of `path`, cannot be created or filled.
std::string Unwritable(const std::filesystem::path& path, std::filesystem::path folder) {
  std::error_code error;
  while (!std::filesystem::exists(folder, error) && folder != ".") {
    folder = folder.has_parent_path() ? folder.parent_path() : ".";
  }
  if (!std::filesystem::is_directory(folder, error)) {
    return path.string() + ": " + folder.string() + " is not a folder; name another folder";
  }
  try {
    const AtomicFile probe(folder / ".dfr-probe");
  } catch (const std::runtime_error&) {
    return path.string() + ": nothing can be created in " + folder.string() +
           "; name a folder that you may write to";
  }
  return "";
}

}  // namespace

std::string UnwritableFile(const std::filesystem::path& path, bool makes_folders) {
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::status(path, error);
  if (std::filesystem::is_directory(status)) {
    return path.string() + ": is a folder; name a file in it";
  }
  if (std::filesystem::exists(status) && !std::filesystem::is_regular_file(status)) return "";
  if (!path.has_filename()) {
    return (path.empty() ? "''" : path.string()) + ": names no file; add a name";
  }
  const std::filesystem::path folder = path.has_parent_path() ? path.parent_path() : ".";
  if (!std::filesystem::exists(folder, error) && !makes_folders) {
    return path.string() + ": there is no folder " + folder.string() +
           "; create it or name another file";
  }
  // A link may be part of a loop, or point to a file in a missing folder.
  const bool link = std::filesystem::is_symlink(path, error);
  if (!std::filesystem::exists(status) && !link) return Unwritable(path, folder);
  try {
    const AtomicFile probe(path);
  } catch (const std::runtime_error& e) {
    return std::string(e.what()) + "; name another file";
  }
  return "";
}

std::string UnwritableFolder(const std::filesystem::path& path) {
  return path.empty() ? "'': names no folder; add a name" : Unwritable(path, path);
}

}  // namespace dfr::core
