#pragma once

#include <cstdint>
#include <filesystem>
#include <iosfwd>
#include <map>
#include <string>
#include <vector>

#include "apps/gallery/policies.h"
#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"
#include "dfr/experiment/experiment.h"

namespace dfr::study::gallery {

/// "alone", then the guard's strategies.
[[nodiscard]] const std::vector<std::string>& MethodNames();

/// The tasks that a command line means, each once: names, "design", "judgement" or "all".
/// @throws std::invalid_argument naming the tasks there are.
[[nodiscard]] std::vector<std::string> SelectTasks(const std::vector<std::string>& words);

/// What is run: every method with every policy of every task, from the same start states.
/// `methods` are with "alone" in any case, `episodes` those of each policy and trial; each trial
/// has demonstrations, policies and start states of its own.
struct Study : experiment::ExperimentOptions {
  Study() {
    methods = MethodNames();
    episodes = 100;
    trials = 3;
    seed = 1;
  }
  std::vector<std::string> tasks;
  std::vector<std::string> policies = {"good", "weak", "biased", "lwr", "knn"};
  int demonstrations = 60;
};

/// One method with one policy of one task, over all trials.
struct Row {
  std::string task;
  std::string policy;
  std::string method;
  int episodes = 0;
  int ok = 0;
  int failed = 0;             ///< Also where the world that moves on after a halt fails.
  int saved = 0;              ///< Failed alone, did not with this method,
  int saved_ok = 0;           ///< and was completed.
  int harmed = 0;             ///< Completed alone, not with this method.
  int alarmed_failures = 0;   ///< Of `failed`, those with an alarm before. Monitor alone.
  int alarmed_successes = 0;  ///< Of `ok`, those with an alarm. Monitor alone.
  double controls = 0.0;      ///< In an episode, on average.
  /// Why others than `ok` ended: "halted: no-progress", or who chose the control that failed.
  std::map<std::string, int> causes = {};
  bool operator==(const Row&) const = default;
};

/// Runs the study, with a ledger and a summary in study.out unless that is empty. Rows come in the
/// order of tasks, policies and methods, "alone" first; the same for any number of threads. Of a
/// shard there are none.
/// @throws std::invalid_argument naming an unknown task, policy or method and those there are; and
///   as experiment::Evaluate() does.
[[nodiscard]] std::vector<Row> RunStudy(const Study& study);

/// What one episode went through.
struct Recording {
  std::string method;  ///< Or "demonstrations".
  core::Outcome outcome = core::Outcome::kHalted;
  core::Matrix states;  ///< One row a state, the start state first; without what follows a halt.
};

/// The first `count` demonstrations of the study's first trial, then its first `count` episodes of
/// each method with one policy of one task, as RunStudy() runs them.
/// @throws std::invalid_argument as RunStudy() does.
[[nodiscard]] std::vector<Recording> Record(const Study& study, const std::string& task,
                                            const std::string& policy, int count);

/// The rows for a terminal, shares in per cent with 95 % intervals. The intervals take episodes as
/// independent; those of one trial share demonstrations and policy. With `causes` they follow each
/// row.
void PrintTable(const std::vector<Row>& rows, bool causes, std::ostream& out);
/// The rows as counts. @throws std::runtime_error naming a file that cannot be written.
void SaveCsv(const std::vector<Row>& rows, const std::filesystem::path& path);

}  // namespace dfr::study::gallery
