#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>

#include "dfr/recording/records.h"

namespace dfr::recording {

enum class PictureFormat {
  kBgr8,
  kRgb8,
  kMono8,
  kJpeg,  ///< Already compressed: kept as it is.
};

/// A picture, borrowed for the duration of a call. Rows from the top, `step` bytes each.
struct PictureView {
  std::int64_t time_ns = 0;    ///< When it was taken, since the Unix epoch.
  std::uint32_t sequence = 0;  ///< StepRecord::image_sequence refers to it.
  PictureFormat format = PictureFormat::kBgr8;
  int width = 0;
  int height = 0;
  int step = 0;
  std::span<const std::uint8_t> data;
};

/// The time that a Recorder's thread lives by.
class RecorderClock {
 public:
  virtual ~RecorderClock() = default;

  /// ns. Never goes back.
  [[nodiscard]] virtual std::int64_t SteadyNs() = 0;
  /// Returns `ns` later, or sooner once the recorder is `stopping`.
  virtual void Wait(std::int64_t ns, const std::atomic<bool>& stopping) = 0;
};

/// Options for Recorder.
struct RecorderOptions {
  /// Steps, transitions and states of the arm that wait for the disk at most, >= 1: 40 s at
  /// 100 Hz.
  std::size_t waiting_records = 4096;
  std::size_t waiting_pictures = 8;  ///< >= 1
  /// Bytes of a picture at most; larger ones are dropped, and counted.
  std::size_t picture_bytes = std::size_t{640} * 480 * 3;
  int jpeg_quality = 90;           ///< In [1, 100].
  RecorderClock* clock = nullptr;  ///< Null: this machine's. Must outlive the recorder.
};

/// Counts since the start.
struct RecorderCounts {
  std::uint64_t records = 0;           ///< Steps, transitions and states of the arm written.
  std::uint64_t pictures = 0;          ///< Written.
  std::uint64_t dropped_records = 0;   ///< The same, lost.
  std::uint64_t dropped_pictures = 0;  ///< Lost.
};

/// Writes a run to an MCAP file (docs/formats.md) without ever making the control loop wait: what
/// it is given is copied into memory set aside at the start, and a thread of its own encodes and
/// writes it a quarter of a second later at most. A killed process therefore loses less than the
/// last second, and the file is readable up to there. (Where the machine itself loses power, what
/// its kernel has not yet written is lost, too.)
///
/// What does not fit because the disk cannot keep up is dropped, counted, and noted in the file. If
/// the disk is full or fails, the run goes on: failed() tells, and the file stays readable up to
/// there.
///
/// Record(), Transition() and Arm() belong to one thread, Picture() to one, which may be another;
/// the others may be called from anywhere.
class Recorder {
 public:
  /// Makes the file.
  /// @throws std::runtime_error naming it and the remedy if it exists or cannot be written;
  ///   std::invalid_argument naming the option that is out of range.
  Recorder(const std::filesystem::path& path, const RecordingMetadata& metadata,
           const RecorderOptions& options = {});
  /// As Finish(), silently.
  ~Recorder();
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;

  /// These neither allocate, lock, wait nor call the system. False if it had to be dropped.
  bool Record(const StepRecord& step) noexcept;
  bool Transition(const TransitionRecord& transition) noexcept;
  bool Arm(const ArmRecord& arm) noexcept;
  bool Picture(const PictureView& picture) noexcept;

  /// Nothing more reaches the file: the disk is full, or failed. Never allocates or waits.
  [[nodiscard]] bool failed() const noexcept;
  /// What was dropped so far, of all kinds. Never allocates or waits.
  [[nodiscard]] std::uint64_t dropped() const noexcept;
  [[nodiscard]] RecorderCounts counts() const noexcept;

  /// Writes all that waits and the file's summary, and closes it. The loop must have ended.
  /// @throws std::runtime_error naming the file and what went wrong since the start, if something
  ///   did.
  void Finish();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::recording
