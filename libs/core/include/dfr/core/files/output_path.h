#pragma once

#include <filesystem>
#include <string>

namespace dfr::core {

/// Checks of output paths that programs call before they begin to work. Both functions try to
/// create a file and remove it at once. Existing files keep their content.

/// Returns one line with the reason why the program cannot write a file at `path`, and the remedy;
/// "" if the file is writable. `makes_folders`: the program creates the missing folders of the
/// path. Does not open a pipe or a device.
[[nodiscard]] std::string UnwritableFile(const std::filesystem::path& path,
                                         bool makes_folders = false);

/// Same as UnwritableFile(), for a folder that will be created with its parents, or filled.
[[nodiscard]] std::string UnwritableFolder(const std::filesystem::path& path);

}  // namespace dfr::core
