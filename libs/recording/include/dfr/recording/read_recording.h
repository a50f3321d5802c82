#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "dfr/recording/records.h"

namespace dfr::recording {

/// Location of a picture in a recording.
struct RecordedPicture {
  std::int64_t time_ns = 0;
  std::uint32_t sequence = 0;
  std::uint64_t offset = 0;  ///< Offset of the JPEG data from the start of the file, bytes.
  std::uint64_t size = 0;    ///< Size of the JPEG data, bytes.
};

/// Message written by the recorder, such as the number of dropped records.
struct RecordedNote {
  std::int64_t time_ns = 0;
  std::string text;
};

/// Contents of a file written by Recorder, bit-exact and in the order of writing.
struct Recording {
  RecordingMetadata metadata;
  std::vector<StepRecord> steps;
  /// Number of each step, starting at 1. A gap means that steps were lost.
  std::vector<std::uint32_t> step_numbers;
  std::vector<TransitionRecord> transitions;
  std::vector<ArmRecord> arm;
  std::vector<RecordedPicture> pictures;
  std::vector<RecordedNote> notes;
  /// Number of missing steps, transitions and arm states, from gaps in their numbering.
  std::uint64_t dropped_records = 0;
  /// Descriptions of the damaged parts of the file, with their positions. Only the contents of
  /// damaged chunks are lost.
  std::vector<std::string> damage;
  /// True if the recorder was stopped normally. If false, it was killed or the file was truncated,
  /// and only complete data are present.
  bool finished = false;
};

/// Reads a file written by Recorder, finished or not.
/// @throws std::runtime_error naming the file, the position and the reason if the file cannot be
///   read, was not written by Recorder, or is damaged before its first chunk of data.
[[nodiscard]] Recording ReadRecording(const std::filesystem::path& path);

}  // namespace dfr::recording
