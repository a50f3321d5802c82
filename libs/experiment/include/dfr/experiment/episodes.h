#pragma once

#include <cstdint>
#include <filesystem>
#include <iosfwd>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/experiment/ledger.h"
#include "dfr/experiment/paired_evaluation.h"

namespace dfr::experiment {

/// One episode of an experiment: unit, method and start state.
struct EpisodeId {
  EvaluationUnit unit;
  std::string method;
  int start = 0;
  bool operator==(const EpisodeId&) const = default;
};

/// Returns "trial/demonstrations/learner/method/start", such as 0/120/8/controller/17.
[[nodiscard]] std::string Name(const EpisodeId& id);

/// Inverse of Name() for the episodes of `plan`. @throws std::invalid_argument naming the error.
[[nodiscard]] EpisodeId ParseEpisode(std::string_view name, const EvaluationPlan& plan);

/// One episode of a run, with the data required to repeat it.
struct RecordedEpisode {
  LedgerHeader header;
  EpisodeId id;
  EpisodeResult result;
  std::uint64_t start_seed = 0;
  std::uint64_t controller_seed = 0;
};

/// Returns the episode called `name` from the ledger in `folder`. `now` is the header that the
/// ledger must match for this build to repeat the episode; nullptr: no check.
/// @throws std::runtime_error naming the folder and the first field that differs, or the unfinished
///   unit of the episode; core::UsageError as ParseEpisode(); and as ReadLedger().
[[nodiscard]] RecordedEpisode FindEpisode(const std::filesystem::path& folder,
                                          std::string_view name, const LedgerHeader* now = nullptr);

/// Condition on the outcome of another method from the same start state.
struct EpisodePartner {
  std::string method = {};                 ///< Method; empty: no condition on another method.
  std::vector<std::string> outcomes = {};  ///< core::Name() of the accepted outcomes.
};

/// Parses a partner such as "baseline=collided,halted".
/// @throws std::invalid_argument for other texts.
[[nodiscard]] EpisodePartner ParsePartner(std::string_view text);

/// Selection of episodes. Empty or 0 selects all.
struct EpisodeFilter {
  std::string method = {};
  std::string learner = {};
  int demonstrations = 0;
  std::vector<std::string> outcomes = {};  ///< core::Name() of the accepted outcomes.
  std::string cause = {};
  EpisodePartner against = {};
};

/// Returns the shell command of `program` that prints the selected episodes of a run in FOLDER.
[[nodiscard]] std::string EpisodesCommand(const std::string& program, const EpisodeFilter& filter);

/// Prints the ids of the selected episodes in these ledgers of one run, each unit once, with
/// outcome, cause and controls: collisions first, then halts, each in descending order of recovery
/// controls. Prints at most `most` unless it is 0. The last line gives the number of selected
/// episodes, their mean number of controls, and the number of all episodes with the filter's
/// method, learner and data point.
/// @throws std::runtime_error naming a method, learner or data point that no ledger contains, or a
///   ledger of another run; if no unit is finished; and as ReadLedger().
void PrintEpisodes(const std::vector<std::filesystem::path>& ledgers, const EpisodeFilter& filter,
                   int most, std::ostream& out);

}  // namespace dfr::experiment
