#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "dfr/dds/participant.h"
#include "dfr/vision/image_view.h"

namespace dfr::hardware {

/// Status of a grabbed picture.
enum class FrameStatus {
  kOk,
  kNever,          ///< No picture has arrived yet.
  kSilent,         ///< No picture has arrived for too long.
  kOld,            ///< The newest picture is too old: delayed, or the sender is frozen.
  kAhead,          ///< Stamped in the future: a clock jumped, or the machines' clocks differ.
  kInvalidStamp,   ///< Stamped zero.
  kEnded,          ///< The file has ended.
  kTruncated,      ///< The file ended before the announced number of pictures.
  kFailed,         ///< The device stopped delivering pictures.
  kWrongSize,      ///< The size differs from the intrinsics' size.
  kWrongEncoding,  ///< Not bgr8, rgb8 or mono8, or an image that cannot be decoded.
  kDark,           ///< Nearly black: light off, cable disconnected, or lens covered.
  kFrozen,         ///< Repeated identical pictures, bit for bit: a working sensor has noise.
};

/// Returns a short description in lower case, without a full stop.
[[nodiscard]] const char* Name(FrameStatus status) noexcept;
/// Returns the remedy for the user; empty for kOk.
[[nodiscard]] const char* Remedy(FrameStatus status) noexcept;

/// A picture and its time of exposure.
struct Frame {
  vision::ImageView image;  ///< Valid until the next Grab(). Blue, green, red.
  int width = 0;            ///< Width as received, even if it is wrong and `image` is empty.
  int height = 0;           ///< Height as received.
  /// Time of exposure since the epoch, from the sender's stamp; for OpenVideo() the arrival time.
  std::int64_t stamp_ns = 0;
  double age_s = 0.0;            ///< Time from the stamp to the call of Grab().
  std::uint64_t sequence = 0;    ///< 1 for the first picture received.
  std::uint64_t num_missed = 0;  ///< Number of pictures skipped since the last Grab().
};

/// Options for all kinds of Endoscope.
struct EndoscopeOptions {
  int width = 640;   ///< Picture width in the intrinsics; pictures of another size are refused.
  int height = 480;  ///< Picture height in the intrinsics.
  /// Period of the pictures, s; a file's frame rate replaces it. Used to count lost pictures.
  double period_s = 1.0 / 30.0;
  double max_age_s = 0.1;     ///< Maximum time since the stamp, and since the arrival, > 0.
  double max_ahead_s = 0.01;  ///< Maximum time from now to a stamp in the future, >= 0.
  int max_repeats = 3;  ///< Number of identical consecutive pictures that count as frozen, > 1.

  /// @throws std::invalid_argument naming the option that is out of range.
  void Check() const;
};

/// Counts since the start.
struct EndoscopeCounts {
  std::uint64_t received = 0;  ///< Number of pictures, including invalid ones.
  std::uint64_t missed = 0;    ///< Number of pictures replaced by a newer one before a Grab().
  /// Number of pictures that never arrived, estimated from gaps between stamps longer than one and
  /// a half periods.
  std::uint64_t lost = 0;
};

/// Source of an endoscope's pictures, which a separate thread reads. The calls below belong to one
/// thread at a time.
class Endoscope {
 public:
  virtual ~Endoscope() = default;

  /// Grabs the newest picture without waiting. Also returns kOk for a picture that was grabbed
  /// before and is still recent; compare its sequence. Otherwise returns the error; `frame` then
  /// still holds the newest picture if its size is right. Never allocates, locks or throws.
  /// @param steady_ns  time of std::chrono::steady_clock.
  /// @param wall_ns  time since the epoch, as in stamps.
  [[nodiscard]] virtual FrameStatus Grab(std::int64_t steady_ns, std::int64_t wall_ns,
                                         Frame& frame) noexcept = 0;
  /// Overload that reads this machine's clocks.
  [[nodiscard]] FrameStatus Grab(Frame& frame) noexcept;

  [[nodiscard]] virtual EndoscopeCounts counts() const noexcept = 0;
  /// Returns the source as given by the caller.
  [[nodiscard]] virtual const std::string& source() const noexcept = 0;
};

/// Returns true if `source` names an image topic rather than a source for OpenVideo(): it begins
/// with a slash, contains only characters that ROS 2 allows in names, and is neither a device nor
/// an existing file.
[[nodiscard]] bool IsImageTopic(const std::string& source);

/// Opens one of the following with OpenCV, and returns once the first picture is available:
///
///   "0", "1", ...            a video device by number
///   "/dev/video0"            a video device by name
///   "... ! ... ! appsink"    a GStreamer pipeline
///   "case7.avi"              a video file, played at its own rate, or one picture per period_s
///                            if it has none
/// @throws std::invalid_argument naming the option that is out of range; core::Error naming the
///   source, the error (missing, no permission, busy, not a video, wrong size) and the remedy.
[[nodiscard]] std::unique_ptr<Endoscope> OpenVideo(const std::string& source,
                                                   const EndoscopeOptions& options);

/// Subscribes to a ROS 2 image topic: sensor_msgs/Image (bgr8, rgb8, mono8), or
/// sensor_msgs/CompressedImage if the name ends with "/compressed". Returns at once; Grab() reports
/// a missing publisher. The participant must outlive the endoscope.
/// @throws std::invalid_argument naming the option that is out of range; std::runtime_error if DDS
///   refuses the topic.
[[nodiscard]] std::unique_ptr<Endoscope> OpenTopic(dds::Participant& participant,
                                                   const std::string& topic,
                                                   const EndoscopeOptions& options);

}  // namespace dfr::hardware
