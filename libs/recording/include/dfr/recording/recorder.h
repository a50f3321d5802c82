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
  kJpeg,  ///< Already compressed; stored unchanged.
};

/// A picture, borrowed for the duration of a call. Rows from the top, `step` bytes each.
struct PictureView {
  std::int64_t time_ns = 0;    ///< Time of exposure, since the Unix epoch.
  std::uint32_t sequence = 0;  ///< Referenced by StepRecord::image_sequence.
  PictureFormat format = PictureFormat::kBgr8;
  int width = 0;
  int height = 0;
  int step = 0;
  std::span<const std::uint8_t> data;
};

/// Clock of the Recorder's thread.
class RecorderClock {
 public:
  virtual ~RecorderClock() = default;

  /// Returns the monotonic time, ns.
  [[nodiscard]] virtual std::int64_t SteadyNs() = 0;
  /// Waits for `ns` nanoseconds. May return earlier once `stopping` is true.
  virtual void Wait(std::int64_t ns, const std::atomic<bool>& stopping) = 0;
};

/// Options for Recorder.
struct RecorderOptions {
  /// Capacity of the queue of steps, transitions and arm states, >= 1. The default holds 40 s at
  /// 100 Hz.
  std::size_t waiting_records = 4096;
  std::size_t waiting_pictures = 8;  ///< Capacity of the queue of pictures, >= 1.
  /// Maximum size of a picture, bytes; larger pictures are dropped and counted.
  std::size_t picture_bytes = std::size_t{640} * 480 * 3;
  int jpeg_quality = 90;           ///< In [1, 100].
  RecorderClock* clock = nullptr;  ///< nullptr: this machine's clock. Must outlive the recorder.
};

/// Counts since the start.
struct RecorderCounts {
  std::uint64_t records = 0;           ///< Number of steps, transitions and arm states written.
  std::uint64_t pictures = 0;          ///< Number of pictures written.
  std::uint64_t dropped_records = 0;   ///< Number of steps, transitions and arm states lost.
  std::uint64_t dropped_pictures = 0;  ///< Number of pictures lost.
};

/// Writes a run to an MCAP file (docs/formats.md) without blocking the control loop. Copies data
/// into preallocated memory; a separate thread encodes and writes them within a quarter of a
/// second. A killed process therefore loses less than the last second, and the file is readable up
/// to that point. A power failure also loses the data that the kernel has not yet written.
///
/// Data that a slow disk cannot accept are dropped, counted and noted in the file. If the disk is
/// full or fails, the run continues: failed() returns true, and the file is readable up to that
/// point.
///
/// Record(), Transition() and Arm() belong to one thread and Picture() to one thread, possibly
/// another. The other members are thread-safe.
class Recorder {
 public:
  /// Creates the file.
  /// @throws std::runtime_error naming the file and the remedy if it exists or cannot be written;
  ///   std::invalid_argument naming the option that is out of range.
  Recorder(const std::filesystem::path& path, const RecordingMetadata& metadata,
           const RecorderOptions& options = {});
  /// Same as Finish(), but never throws.
  ~Recorder();
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;

  /// The next four members do not allocate, lock, wait or make system calls. They return false if
  /// the data were dropped.
  bool Record(const StepRecord& step) noexcept;
  bool Transition(const TransitionRecord& transition) noexcept;
  bool Arm(const ArmRecord& arm) noexcept;
  bool Picture(const PictureView& picture) noexcept;

  /// True if no more data can be written because the disk is full or failed. Never allocates or
  /// waits.
  [[nodiscard]] bool failed() const noexcept;
  /// Returns the number of dropped items of all kinds. Never allocates or waits.
  [[nodiscard]] std::uint64_t dropped() const noexcept;
  [[nodiscard]] RecorderCounts counts() const noexcept;

  /// Writes all pending data and the file's summary, and closes the file. The loop must have ended.
  /// @throws std::runtime_error naming the file and the error if anything has failed since the
  ///   start.
  void Finish();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::recording
