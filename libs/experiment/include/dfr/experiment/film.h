#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/features.h"
#include "dfr/core/matrix.h"
#include "dfr/experiment/paired_evaluation.h"
#include "dfr/experiment/report.h"

namespace dfr::experiment {

/// What one method did in an episode.
struct FilmedEpisode {
  std::string method;
  EpisodeResult result;
  core::Matrix states;         ///< (controls + 1) x state_dim, the start state first.
  std::vector<bool> recovery;  ///< Whether control t was of a recovery; empty: none was.
};

/// "collided: policy after 17 controls, 4 of them recovery".
[[nodiscard]] std::string DescribeEnd(const EpisodeResult& result);

/// Writes a page about episodes from one start state: their paths in the plane of two entries of
/// the state, side by side, and each entry over the controls, one line a method. States need no
/// pictures, so that this works for every plant.
/// @param entries  two of `layout`, as core::FeatureSelection has them; empty: the first two. A
///   state of one entry has no paths.
/// @param media    pictures of the same episodes, to be embedded before.
/// @throws std::runtime_error naming the file if it does not end with .html or cannot be written;
///   std::invalid_argument unless there are two entries.
void SaveFilm(const std::string& title, const core::StateLayout& layout,
              std::span<const FilmedEpisode> episodes, const std::filesystem::path& path,
              const std::string& entries = "", const std::vector<ReportMedia>& media = {});

}  // namespace dfr::experiment
