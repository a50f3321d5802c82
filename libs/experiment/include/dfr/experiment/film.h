#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/features/features.h"
#include "dfr/core/matrix.h"
#include "dfr/experiment/paired_evaluation.h"
#include "dfr/experiment/report.h"

namespace dfr::experiment {

/// States and outcome of one method in an episode.
struct FilmedEpisode {
  std::string method;
  EpisodeResult result;
  core::Matrix states;         ///< (controls + 1) x state_dim, the start state first.
  std::vector<bool> recovery;  ///< True if a recovery chose control t; empty: no recoveries.
};

/// Returns text such as "collided: policy after 17 controls, 4 of them recovery".
[[nodiscard]] std::string DescribeEnd(const EpisodeResult& result);

/// @throws std::runtime_error unless the file's extension is .html, as SaveFilm() requires.
void CheckPage(const std::filesystem::path& path);

/// Writes a page about episodes from one start state: their paths in the plane of two state
/// entries, side by side, and each state entry over the number of controls, one line per method.
/// Needs no pictures and works for every plant.
/// @param entries  two entries of `layout`, in the format of core::FeatureSelection; empty: the
///   first two. A one-dimensional state has no paths.
/// @param media    pictures of the same episodes, embedded first.
/// @throws std::runtime_error naming the file if it does not end with .html or cannot be written;
///   std::invalid_argument unless there are two entries.
void SaveFilm(const std::string& title, const core::StateLayout& layout,
              std::span<const FilmedEpisode> episodes, const std::filesystem::path& path,
              const std::string& entries = "", const std::vector<ReportMedia>& media = {});

}  // namespace dfr::experiment
