#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <string>

#include "dfr/dds/messages.h"
#include "feed.h"

namespace dfr::hardware::internal {

/// Puts pictures into `feed` until `stop`, or until there are no more, which it says by
/// Feed::End(). What it throws is FrameStatus::kFailed.
using Read = std::function<void(Feed& feed, const std::atomic<bool>& stop)>;

/// An endoscope with a thread of its own that calls `read`.
[[nodiscard]] std::unique_ptr<Endoscope> MakeEndoscope(const std::string& source,
                                                       const EndoscopeOptions& options,
                                                       const Read& read);

/// Returns `time_s` after its first call, which is with 0, or sooner once told to stop.
using Pace = std::function<void(double time_s, const std::atomic<bool>& stop)>;

/// As hardware::OpenVideo(), for a file that is played at `pace`.
[[nodiscard]] std::unique_ptr<Endoscope> OpenVideo(const std::string& source,
                                                   const EndoscopeOptions& options,
                                                   const Pace& pace);

/// Puts a message's picture, decoded, or says that nobody can read it.
void Put(Feed& feed, const dds::Image& image, std::int64_t arrival_ns);
void Put(Feed& feed, const dds::CompressedImage& image, std::int64_t arrival_ns);

/// std::chrono::steady_clock, ns.
[[nodiscard]] std::int64_t SteadyNs() noexcept;

}  // namespace dfr::hardware::internal
