#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <string>

#include "dfr/dds/messages.h"
#include "feed.h"

namespace dfr::hardware::internal {

/// Puts pictures into `feed` until `stop` is true or the source ends. Reports the source's end by
/// Feed::End(). Exceptions become FrameStatus::kFailed.
using Read = std::function<void(Feed& feed, const std::atomic<bool>& stop)>;

/// Returns an endoscope whose separate thread calls `read`.
[[nodiscard]] std::unique_ptr<Endoscope> MakeEndoscope(const std::string& source,
                                                       const EndoscopeOptions& options,
                                                       const Read& read);

/// Waits until `time_s` after the first call, which passes 0, or until a stop is requested.
using Pace = std::function<void(double time_s, const std::atomic<bool>& stop)>;

/// Same as hardware::OpenVideo() for a file, played at `pace`.
[[nodiscard]] std::unique_ptr<Endoscope> OpenVideo(const std::string& source,
                                                   const EndoscopeOptions& options,
                                                   const Pace& pace);

/// Decodes a message's picture and puts it into `feed`, or reports a failed decoding to `feed`.
void Put(Feed& feed, const dds::Image& image, std::int64_t arrival_ns);
void Put(Feed& feed, const dds::CompressedImage& image, std::int64_t arrival_ns);

/// Returns std::chrono::steady_clock's time, ns.
[[nodiscard]] std::int64_t SteadyNs() noexcept;

}  // namespace dfr::hardware::internal
