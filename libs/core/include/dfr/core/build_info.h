#pragma once

namespace dfr::core {

/// The version of this build, "0.1.0".
[[nodiscard]] const char* BuildVersion() noexcept;

/// The commit that was built, with "+changes" behind it where the tree had uncommitted ones;
/// "unknown" for a build outside a git checkout. Results carry it.
[[nodiscard]] const char* BuildCommit() noexcept;

}  // namespace dfr::core
