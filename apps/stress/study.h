#pragma once

#include <cstdint>
#include <filesystem>
#include <iosfwd>
#include <string>
#include <vector>

#include "apps/stress/task.h"
#include "dfr/experiment/experiment.h"
#include "dfr/experiment/report.h"
#include "dfr/experiment/sequential_test.h"

namespace dfr::study::stress {

/// What is run: every controller around every policy, in every task under every condition, from the
/// same start states. None is drawn anew: one outside the support counts like any other.
struct Study : experiment::ExperimentOptions {
  Study() {
    out = "out/stress";
    seed = 4711;
    trials = 3;
    episodes = 20;
  }
  std::vector<std::string> tasks = TaskNames();
  /// Names from kPolicies, or "learned": the weak network.
  std::vector<std::string> policies = {"lwr", "learned"};
  std::vector<std::string> controllers = {"early-stopping", "dfr", "guided"};  ///< And "baseline".
  std::vector<std::string> conditions = {};  ///< Names of Conditions(); empty: all.
  int demonstrations = 60;
};

/// One controller around one policy, in one task under one condition.
struct Row {
  std::string task;
  std::string condition;
  std::string policy;
  std::string controller;
  int episodes = 0;
  int completed = 0;
  int collided = 0;
  int saved = 0;   ///< Start states from which the policy alone collides, and this does not.
  int harmed = 0;  ///< From which the policy alone completes, and this does not.
};

/// Runs the study, with a progress bar and a ledger in study.out, and goes on where an earlier run
/// was interrupted. Rows come in the order of tasks, conditions, policies and controllers, the
/// policy alone first; the same for any number of threads. Of a shard there are none.
/// @throws std::invalid_argument naming what is unknown and what there is; and as
///   experiment::Evaluate() does.
[[nodiscard]] std::vector<Row> RunStudy(const Study& study);

/// Two methods, as study::ParseMethod() takes them, in one task under one condition.
struct Comparison {
  std::string task = "pusher";
  std::string condition = "as demonstrated";
  std::string first = "guided@lwr";
  std::string second = "lwr";
  int demonstrations = 60;
  int trials = 5;    ///< Each with its own demonstrations and policies; they take turns.
  int pairs = 1000;  ///< At most.
  double alpha = 0.05;
  experiment::EpisodeCredit credit = {};
  std::uint64_t seed = 4711;
};

/// Runs pairs of episodes from the same start states until the difference of their credits is
/// settled, or Comparison::pairs are run. No start state is drawn anew.
/// @throws std::invalid_argument naming what is unknown and what there is.
[[nodiscard]] experiment::SequentialTest Compare(const Comparison& comparison);

/// A table a policy, with a row for each task and condition: completed / collided of each
/// controller, then saved / harmed, in per cent. Behind them a table of means and worst rows.
[[nodiscard]] std::vector<experiment::ReportTable> MakeTables(const std::vector<Row>& rows);

/// What support and controller buy, a table a policy, from rows whose controllers are
/// "<controller>/<support>": means over all tasks and conditions of completed / collided in per
/// cent.
[[nodiscard]] std::vector<experiment::ReportTable> MakeGrid(const std::vector<Row>& rows);

/// Rows of a good policy (one that completes at least half of the episodes) in which `controller`
/// collides in more than .5 % or harms more than 2 %.
[[nodiscard]] experiment::ReportTable WhereItFails(const std::vector<Row>& rows,
                                                   const std::string& controller);

/// The rows as counts. @throws std::runtime_error naming a file that cannot be written.
void SaveCsv(const std::vector<Row>& rows, const std::filesystem::path& path);

}  // namespace dfr::study::stress
