#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>

#include "apps/rollout_video.h"
#include "dfr/control/rollout.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {

/// Size of DrawBothViews()'s picture.
inline constexpr int kPictureWidth = 1280;
inline constexpr int kPictureHeight = 480;

/// Draws the results of vision beside an outside view of arm and platform: kPictureWidth x
/// kPictureHeight, RGB, rows from the top.
void DrawBothViews(const sim::LineTrackingPlant& plant, std::span<std::uint8_t> rgb);

/// Draws and encodes one picture, as Record() and RecordEpisode() do.
/// @throws std::runtime_error naming the cause of a failure.
void CheckFilm(const std::filesystem::path& path, const sim::LineTrackingOptions& options);

/// Runs one episode and records the pictures that RecordEpisode() writes.
[[nodiscard]] RolloutVideo Record(LineTrialRunner& runner, int method, const std::string& title,
                                  std::uint64_t start_seed, std::uint64_t controller_seed);

/// Runs one episode and writes it as a video: the endoscope's picture with the results of vision,
/// an outside view of arm and platform, and g(t), threshold and mode below. The ending of `path`
/// chooses the format: .mp4 (H.264) or .webm (VP8). Recoveries are shown every tenth control,
/// because their controls are many and small.
/// @throws std::runtime_error naming the file if it cannot be written or its ending is unknown.
control::RolloutResult RecordEpisode(LineTrialRunner& runner, int method, const std::string& title,
                                     std::uint64_t start_seed, std::uint64_t controller_seed,
                                     const std::filesystem::path& path);

}  // namespace dfr::apps::line_tracking
