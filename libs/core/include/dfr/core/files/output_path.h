#pragma once

#include <filesystem>
#include <string>

namespace dfr::core {

/// Checks for programs that reject an output path before they begin to work. Both functions try to
/// create a file and remove it at once. Existing files keep their content.

/// Returns one line that says why the program cannot write a file at `path`, with the remedy; "" if
/// it can. `makes_folders`: the program creates the missing folders of the path. A pipe or device
/// is not opened.
[[nodiscard]] std::string UnwritableFile(const std::filesystem::path& path,
                                         bool makes_folders = false);

/// Same as UnwritableFile(), for a folder that will be created with its parents, or filled.
[[nodiscard]] std::string UnwritableFolder(const std::filesystem::path& path);

}  // namespace dfr::core
