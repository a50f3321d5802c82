#include "dfr/hardware/endoscope.h"

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <iterator>
#include <system_error>

#include "dfr/core/contract.h"
#include "dfr/dds/messages.h"
#include "reading_endoscope.h"

namespace dfr::hardware {

namespace {

struct StatusWords {
  FrameStatus status;
  const char* name;
  const char* remedy;
};
constexpr StatusWords kStatusWords[] = {
    {FrameStatus::kOk, "ok", ""},
    {FrameStatus::kNever, "no picture has arrived yet",
     "check that a program publishes images on this topic, in this DDS domain"},
    {FrameStatus::kSilent, "no picture has arrived for too long",
     "check the camera's program, the cable and the network"},
    {FrameStatus::kOld, "pictures are too old",
     "set both machines' clocks by NTP or PTP; if they agree, the camera's program stalls"},
    {FrameStatus::kAhead, "pictures are stamped in the future",
     "set both machines' clocks by NTP or PTP"},
    {FrameStatus::kInvalidStamp, "pictures are stamped zero",
     "the camera's driver must stamp its pictures"},
    {FrameStatus::kEnded, "the video has ended", "a file plays once; open it again"},
    {FrameStatus::kTruncated, "the video file is truncated", "record or copy the file again"},
    {FrameStatus::kFailed, "the video device delivers no more pictures",
     "check the device's cable and power, then open it again"},
    {FrameStatus::kWrongSize, "the pictures differ in size from the intrinsics",
     "set the camera to the size it was calibrated at, or calibrate at this one"},
    {FrameStatus::kWrongEncoding, "the encoding of the pictures is not supported",
     "let the driver publish bgr8, rgb8, mono8 or jpeg"},
    {FrameStatus::kDark, "pictures are black",
     "switch on the light source, remove the lens cap, and check the cable"},
    {FrameStatus::kFrozen, "the same picture is repeated",
     "restart the camera's program or the frame grabber"},
};

StatusWords WordsOf(FrameStatus status) {
  const auto* const words = std::ranges::find(kStatusWords, status, &StatusWords::status);
  return words != std::end(kStatusWords) ? *words : StatusWords{status, "unknown", ""};
}

}  // namespace

const char* Name(FrameStatus status) noexcept { return WordsOf(status).name; }

const char* Remedy(FrameStatus status) noexcept { return WordsOf(status).remedy; }

void EndoscopeOptions::Check() const {
  const auto positive = [](double value) { return value > 0.0 && value < 1e6; };
  DFR_THROW_UNLESS(width > 0 && height > 0 && width <= 16384 && height <= 16384,
                   "width and height must lie in [1, 16384], not " << width << " x " << height);
  DFR_THROW_UNLESS(positive(period_s), "period_s must be positive, not " << period_s);
  DFR_THROW_UNLESS(positive(max_age_s), "max_age_s must be positive, not " << max_age_s);
  DFR_THROW_UNLESS(max_ahead_s >= 0.0 && max_ahead_s < 1e6,
                   "max_ahead_s must not be negative: " << max_ahead_s);
  DFR_THROW_UNLESS(max_repeats > 1, "max_repeats must be larger than 1, not " << max_repeats);
}

bool IsImageTopic(const std::string& source) {
  const auto allowed = [](unsigned char c) {
    return std::isalnum(c) != 0 || c == '_' || c == '/' || c == '~';
  };
  std::error_code error;
  return source.rfind('/', 0) == 0 && source.rfind("/dev/", 0) != 0 &&
         std::all_of(source.begin(), source.end(), allowed) &&
         !std::filesystem::exists(source, error);
}

FrameStatus Endoscope::Grab(Frame& frame) noexcept {
  return Grab(internal::SteadyNs(), dds::Stamp::Now().nanoseconds(), frame);
}

}  // namespace dfr::hardware
