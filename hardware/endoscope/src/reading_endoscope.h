#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <string>

#include "feed.h"

namespace dfr::hardware::internal {

/// Puts pictures into `feed` until `stop`, or until there are no more, which it says by
/// Feed::End(). What it throws is FrameStatus::kFailed.
using Read = std::function<void(Feed& feed, const std::atomic<bool>& stop)>;

/// An endoscope with a thread of its own that calls `read`.
[[nodiscard]] std::unique_ptr<Endoscope> MakeEndoscope(const std::string& source,
                                                       const EndoscopeOptions& options,
                                                       const Read& read);

/// std::chrono::steady_clock, ns.
[[nodiscard]] std::int64_t SteadyNs() noexcept;

}  // namespace dfr::hardware::internal
