#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "apps/study/planar/methods.h"
#include "apps/study/runner.h"
#include "apps/study/task.h"
#include "dfr/experiment/experiment.h"
#include "dfr/experiment/film.h"
#include "dfr/experiment/sequential_test.h"

namespace dfr::study {

/// What is run: every method around every policy, in every task under every condition, from the
/// same start states. None is drawn anew: one outside the support counts like any other. Each trial
/// has demonstrations, policies and start states of its own. The policy alone runs in any case.
struct Study : experiment::ExperimentOptions {
  /// Controllers under all conditions in all tasks.
  Study() {
    out = "out/stress";
    seed = 4711;
    trials = 3;
    episodes = 20;
  }
  /// Guards at their default settings, as demonstrated, in the tasks of the gallery.
  [[nodiscard]] static Study OfGuards();
  /// Controllers, the certified one among them, around a polynomial, as demonstrated, in a planar
  /// task.
  [[nodiscard]] static Study OfPlane();

  Kind kind = Kind::kControllers;
  std::vector<std::string> tasks = {"all"};  ///< As SelectTasks() takes them.
  /// Around controllers names from kPolicies, or "learned": the weak network. Inside guards
  /// PolicyNames().
  std::vector<std::string> policies = {"lwr", "learned"};
  std::vector<std::string> controllers = {"early-stopping", "dfr", "guided"};
  std::vector<std::string> conditions = {};  ///< Names of Conditions(); empty: all.
  int demonstrations = 60;
  planar::MethodOptions plane = {};  ///< For planar tasks.
};

/// The strategies of guards. A study of guards or controllers takes PlaceboNames() besides.
[[nodiscard]] const std::vector<std::string>& GuardNames();

/// What one trial adds to a Row.
struct TrialCounts {
  int episodes = 0;
  int completed = 0;
  int collided = 0;
  int halted = 0;
  int saved = 0;
  int harmed = 0;
  double controls = 0.0;  ///< In all episodes.
  double changed = 0.0;   ///< Controls among them that are not the policy's to the bit.
  bool operator==(const TrialCounts&) const = default;
};

/// One method around one policy, in one task under one condition, over all trials.
struct Row {
  std::string task;
  std::string condition;
  std::string policy;
  std::string controller;
  int episodes = 0;
  int completed = 0;
  int collided = 0;           ///< Also where the world that moves on after a halt collides.
  int saved = 0;              ///< Start states from which the policy alone collides, and this not,
  int harmed = 0;             ///< from which it completes, and this does not.
  int saved_completed = 0;    ///< Of `saved`, those that this completes.
  int alarmed_failures = 0;   ///< Of `collided`, those with an alarm before. Monitor alone.
  int alarmed_successes = 0;  ///< Of `completed`, those with an alarm. Monitor alone.
  double controls = 0.0;      ///< In an episode, on average.
  double changed = 0.0;       ///< Those of `controls` that are not the policy's to the bit.
  std::vector<int> recoveries = {};  ///< Controls of each. In planar tasks alone.
  /// Why others than `completed` ended: "halted: no-progress", or who chose the control that
  /// collided.
  std::map<std::string, int> causes = {};
  double change = 0.0;    ///< Sum of control::Step::change over changed controls that have one.
  int sized_changes = 0;  ///< Number of these.
  std::vector<TrialCounts> trials = {};  ///< [trial]
  bool operator==(const Row&) const = default;
};

/// Runs the study, with a progress bar and a ledger in study.out unless that is empty, and goes on
/// where an earlier run was interrupted. Rows come in the order of tasks, conditions, policies and
/// controllers, the policy alone first; the same for any number of threads. Of a shard there are
/// none.
/// @throws std::invalid_argument naming what is unknown and what there is; and as
///   experiment::Evaluate() does.
[[nodiscard]] std::vector<Row> RunStudy(const Study& study);

/// The first `count` demonstrations of the first trial of a study of guards in one task, as
/// "demonstrations", then its first `count` episodes of each method with its first policy.
/// @throws std::invalid_argument as RunStudy() does.
[[nodiscard]] std::vector<experiment::FilmedEpisode> RecordStudy(const Study& study, int count);

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

}  // namespace dfr::study
