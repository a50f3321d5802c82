#pragma once

namespace dfr::core {

/// Returns the version of this build, for example "0.1.0".
[[nodiscard]] const char* BuildVersion() noexcept;

/// Returns the commit of this build. For a tree with uncommitted changes, the suffix "+changes."
/// and 8 digits of the hash of the changes follow. Returns "unknown" for a build outside a git
/// checkout. Result files record it.
[[nodiscard]] const char* BuildCommit() noexcept;

}  // namespace dfr::core
