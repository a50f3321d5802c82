#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "dfr/dds/participant.h"
#include "dfr/vision/image_view.h"

namespace dfr::hardware {

/// What a picture is worth.
enum class FrameStatus {
  kOk,
  kNever,          ///< No picture has come yet.
  kSilent,         ///< None has come for too long.
  kOld,            ///< The newest was taken too long ago: delayed, or the sender is frozen.
  kAhead,          ///< Stamped in the future: a clock has jumped, or the machines' clocks differ.
  kInvalidStamp,   ///< Stamped zero.
  kEnded,          ///< The file has ended.
  kTruncated,      ///< The file ended before all the pictures that it announced.
  kFailed,         ///< The device delivers no more.
  kWrongSize,      ///< Not the size that the intrinsics are for.
  kWrongEncoding,  ///< Neither bgr8, rgb8 nor mono8, or an image that cannot be decoded.
  kDark,           ///< Nearly black: light off, cable out, lens covered.
  kFrozen,         ///< The same picture several times, bit for bit: a living sensor has noise.
};

/// In plain words, lower case, without a full stop.
[[nodiscard]] const char* Name(FrameStatus status) noexcept;
/// What the user can do about it; empty for kOk.
[[nodiscard]] const char* Remedy(FrameStatus status) noexcept;

/// A picture and when it was taken.
struct Frame {
  vision::ImageView image;  ///< Valid until the next Grab(). Blue, green, red.
  int width = 0;   ///< The picture's as it came, also where `image` is empty because of it.
  int height = 0;  ///< The same.
  /// When it was taken, since the epoch: by the sender's stamp, with VideoCapture by its arrival.
  std::int64_t stamp_ns = 0;
  double age_s = 0.0;            ///< From the stamp to the call of Grab().
  std::uint64_t sequence = 0;    ///< 1 for the first picture that came.
  std::uint64_t num_missed = 0;  ///< Pictures that came since the last Grab() that got one, unseen.
};

/// Options for all kinds of Endoscope.
struct EndoscopeOptions {
  int width = 640;   ///< The intrinsics'; pictures of another size are refused.
  int height = 480;  ///< The same.
  /// From one picture to the next, s: a file is played at this speed, and gaps count as losses.
  double period_s = 1.0 / 30.0;
  double max_age_s = 0.1;     ///< From stamp to now, and from arrival to now: three periods. > 0.
  double max_ahead_s = 0.01;  ///< By how much a stamp may lie in the future, >= 0.
  int max_repeats = 3;        ///< A picture that comes so often in a row is frozen, > 1.
  double open_timeout_s = 10.0;  ///< For the first picture of a device or file, > 0.

  /// @throws std::invalid_argument naming the option that is out of range.
  void Check() const;
};

/// What has come so far.
struct EndoscopeCounts {
  std::uint64_t received = 0;  ///< Pictures, wrong ones included.
  std::uint64_t missed = 0;    ///< Replaced by a newer one before anybody looked.
  /// Pictures that never came, by gaps between stamps of more than one and a half periods.
  std::uint64_t lost = 0;
};

/// A source of an endoscope's pictures, with a thread of its own that reads them. The calls below
/// belong to one thread at a time.
class Endoscope {
 public:
  virtual ~Endoscope() = default;

  /// The newest picture, without waiting: with kOk, also if it was grabbed before and is still
  /// young enough (its sequence tells). Otherwise says what is wrong; `frame` then has the newest
  /// picture all the same, if there is one of the right size. Never allocates, locks or throws.
  /// @param steady_ns  of std::chrono::steady_clock.
  /// @param wall_ns  since the epoch, as stamps are.
  [[nodiscard]] virtual FrameStatus Grab(std::int64_t steady_ns, std::int64_t wall_ns,
                                         Frame& frame) noexcept = 0;
  /// By this machine's clocks.
  [[nodiscard]] FrameStatus Grab(Frame& frame) noexcept;

  [[nodiscard]] virtual EndoscopeCounts counts() const noexcept = 0;
  /// What it reads from, as given.
  [[nodiscard]] virtual const std::string& source() const noexcept = 0;
};

/// Whether `source` names an image topic rather than what OpenVideo() takes: it begins with a
/// slash, has only characters that ROS 2 allows in names, and is no device and no existing file.
[[nodiscard]] bool IsImageTopic(const std::string& source);

/// Opens
///   "0", "1", ...            a video device by its number
///   "/dev/video0"            a video device by its name
///   "... ! ... ! appsink"    a GStreamer pipeline
///   "case7.avi"              a video file, played at its own speed, or one picture per period_s
///                            where it does not tell one
/// with OpenCV. Returns when the first picture is there.
/// @throws std::invalid_argument naming the option that is out of range; core::Error naming the
///   source, what is wrong with it (missing, no permission, busy, not a video, wrong size) and the
///   remedy.
[[nodiscard]] std::unique_ptr<Endoscope> OpenVideo(const std::string& source,
                                                   const EndoscopeOptions& options);

/// Subscribes to a ROS 2 image topic: sensor_msgs/Image (bgr8, rgb8, mono8), or
/// sensor_msgs/CompressedImage where the name ends with "/compressed". Returns at once; whether
/// there is a publisher Grab() tells. The participant has to outlive the endoscope.
/// @throws std::invalid_argument naming the option that is out of range; std::runtime_error if DDS
///   refuses the topic.
[[nodiscard]] std::unique_ptr<Endoscope> OpenTopic(dds::Participant& participant,
                                                   const std::string& topic,
                                                   const EndoscopeOptions& options);

}  // namespace dfr::hardware
