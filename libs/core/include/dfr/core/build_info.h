#pragma once

namespace dfr::core {

/// Returns the version of this build, for example "0.1.0".
[[nodiscard]] const char* BuildVersion() noexcept;

/// Returns the commit of this build, with the suffix "+changes" for a tree with uncommitted
/// changes. Returns "unknown" for a build outside a git checkout. Result files record it.
[[nodiscard]] const char* BuildCommit() noexcept;

}  // namespace dfr::core
