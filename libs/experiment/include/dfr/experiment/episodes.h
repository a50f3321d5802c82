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

/// "trial/demonstrations/learner/method/start", as in 0/120/8/guided/17.
[[nodiscard]] std::string Name(const EpisodeId& id);

/// The episode of `plan` that Name() calls so. @throws std::invalid_argument naming what is wrong.
[[nodiscard]] EpisodeId ParseEpisode(std::string_view name, const EvaluationPlan& plan);

/// One episode of a run, and what it takes to run it again.
struct RecordedEpisode {
  LedgerHeader header;
  EpisodeId id;
  EpisodeResult result;
  std::uint64_t start_seed = 0;
  std::uint64_t controller_seed = 0;
};

/// The episode that Name() calls so, of the ledger in `folder`. `now` is what the ledger must be of
/// for this build to run the episode again; null: anything.
/// @throws std::runtime_error naming the folder, and the first field in which the two differ or
///   that the episode's unit is not finished; as ReadLedger() and ParseEpisode().
[[nodiscard]] RecordedEpisode FindEpisode(const std::filesystem::path& folder,
                                          std::string_view name, const LedgerHeader* now = nullptr);

/// How another method ended from the same start state.
struct EpisodePartner {
  std::string method = {};                 ///< Empty: nothing is asked of another method.
  std::vector<std::string> outcomes = {};  ///< core::Name() of each; one of them.
};

/// The partner that "baseline=collided,halted" names.
/// @throws std::invalid_argument for other texts.
[[nodiscard]] EpisodePartner ParsePartner(std::string_view text);

/// Which episodes are meant. Empty, or 0: all.
struct EpisodeFilter {
  std::string method = {};
  std::string learner = {};
  int demonstrations = 0;
  std::vector<std::string> outcomes = {};  ///< core::Name() of each; one of them.
  std::string cause = {};
  EpisodePartner against = {};
};

/// The command of `program` that prints these episodes of a run in FOLDER, as a shell takes it.
[[nodiscard]] std::string EpisodesCommand(const std::string& program, const EpisodeFilter& filter);

/// Prints the ids of episodes in these ledgers with outcome, cause and controls: collisions first,
/// then halts, in each those with the most recovery controls first; at most `most` of them unless
/// that is 0. The last line says how many they are, of how many that have the filter's method,
/// learner and data point, and how many controls they took on average.
/// @throws std::runtime_error naming a method, learner or data point that no ledger has; as
///   ReadLedger().
void PrintEpisodes(const std::vector<std::filesystem::path>& ledgers, const EpisodeFilter& filter,
                   int most, std::ostream& out);

}  // namespace dfr::experiment
