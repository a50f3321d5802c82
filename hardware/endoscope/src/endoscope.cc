#include "dfr/hardware/endoscope.h"

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <system_error>

#include "dfr/core/contract.h"
#include "dfr/dds/messages.h"
#include "reading_endoscope.h"

namespace dfr::hardware {

const char* Name(FrameStatus status) noexcept {
  switch (status) {
    case FrameStatus::kOk:
      return "ok";
    case FrameStatus::kNever:
      return "no picture has arrived yet";
    case FrameStatus::kSilent:
      return "no picture has arrived for too long";
    case FrameStatus::kOld:
      return "pictures are too old";
    case FrameStatus::kAhead:
      return "pictures are stamped in the future";
    case FrameStatus::kInvalidStamp:
      return "pictures are stamped zero";
    case FrameStatus::kEnded:
      return "the video has ended";
    case FrameStatus::kTruncated:
      return "the video file is truncated";
    case FrameStatus::kFailed:
      return "the video device delivers no more pictures";
    case FrameStatus::kWrongSize:
      return "the pictures differ in size from the intrinsics";
    case FrameStatus::kWrongEncoding:
      return "the encoding of the pictures is not supported";
    case FrameStatus::kDark:
      return "pictures are black";
    case FrameStatus::kFrozen:
      return "the same picture is repeated";
  }
  return "unknown";
}

const char* Remedy(FrameStatus status) noexcept {
  switch (status) {
    case FrameStatus::kOk:
      return "";
    case FrameStatus::kNever:
      return "does any program publish images on this topic, in this DDS domain?";
    case FrameStatus::kSilent:
      return "check the camera's program, the cable and the network";
    case FrameStatus::kOld:
      return "set both machines' clocks by NTP or PTP; if they agree, the camera's program stalls";
    case FrameStatus::kAhead:
      return "set both machines' clocks by NTP or PTP";
    case FrameStatus::kInvalidStamp:
      return "the camera's driver must stamp its pictures";
    case FrameStatus::kEnded:
      return "a file plays once; open it again";
    case FrameStatus::kTruncated:
      return "record or copy the file again";
    case FrameStatus::kFailed:
      return "check the device's cable and power, then open it again";
    case FrameStatus::kWrongSize:
      return "set the camera to the size it was calibrated at, or calibrate at this one";
    case FrameStatus::kWrongEncoding:
      return "let the driver publish bgr8, rgb8, mono8 or jpeg";
    case FrameStatus::kDark:
      return "switch on the light source, remove the lens cap, and check the cable";
    case FrameStatus::kFrozen:
      return "restart the camera's program or the frame grabber";
  }
  return "";
}

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
