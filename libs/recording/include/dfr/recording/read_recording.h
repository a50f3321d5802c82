#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "dfr/recording/records.h"

namespace dfr::recording {

/// Where a picture is in a recording.
struct RecordedPicture {
  std::int64_t time_ns = 0;
  std::uint32_t sequence = 0;
  std::uint64_t offset = 0;  ///< Where the JPEG file begins, in bytes from the recording's start.
  std::uint64_t size = 0;    ///< Size of the JPEG file, bytes.
};

/// A remark of the recorder itself: how much it had to drop.
struct RecordedNote {
  std::int64_t time_ns = 0;
  std::string text;
};

/// What Recorder wrote, in the order of writing, bit for bit.
struct Recording {
  RecordingMetadata metadata;
  std::vector<StepRecord> steps;
  /// The number of each step, which begins at 1: where one is missing, one was lost.
  std::vector<std::uint32_t> step_numbers;
  std::vector<TransitionRecord> transitions;
  std::vector<ArmRecord> arm;
  std::vector<RecordedPicture> pictures;
  std::vector<RecordedNote> notes;
  /// Steps, transitions and states of the arm that are missing between those that are there.
  std::uint64_t dropped_records = 0;
  /// What of the file has changed since it was written, each with its place, in words. What a
  /// damaged chunk held is lost, and nothing else.
  std::vector<std::string> damage;
  /// The recorder was stopped in an orderly way. Otherwise it was killed, or the file was cut: what
  /// is here is all that was complete.
  bool finished = false;
};

/// Reads a file of Recorder's, finished or not.
/// @throws std::runtime_error naming the file, the place and the reason if it cannot be read, is
///   not such a file, or is damaged before its first chunk, where its types are.
[[nodiscard]] Recording ReadRecording(const std::filesystem::path& path);

/// The JPEG file of one picture of the recording at `path`. @throws std::runtime_error
[[nodiscard]] std::vector<std::uint8_t> ReadPicture(const std::filesystem::path& path,
                                                    const RecordedPicture& picture);

}  // namespace dfr::recording
