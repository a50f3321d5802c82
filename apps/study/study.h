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

/// A study: every method around every policy, in every task under every condition, from the same
/// start states. Only Kind::kPlane replaces start states outside the support. Each trial has
/// separate demonstrations, policies and start states. The policy alone always runs.
struct Study : experiment::ExperimentOptions {
  /// Creates a study of controllers under all conditions in all tasks.
  Study() {
    out = "out/stress";
    seed = 4711;
    trials = 3;
    episodes = 20;
  }
  /// Returns a study of guards at default settings in the gallery, under the condition "as
  /// demonstrated".
  [[nodiscard]] static Study OfGuards();
  /// Returns a study of controllers, including the certified one, around a polynomial policy in a
  /// planar task, under the condition "as demonstrated".
  [[nodiscard]] static Study OfPlane();

  Kind kind = Kind::kControllers;
  std::vector<std::string> tasks = {"all"};  ///< Arguments of SelectTasks().
  /// With controllers: names from kPolicies, or "learned", the weak network. With guards:
  /// PolicyNames().
  std::vector<std::string> policies = {"lwr", "lwr-online", "learned"};
  std::vector<std::string> controllers = {"early-stopping", "dfr", "controller"};
  std::vector<std::string> conditions = {};  ///< Names of Conditions(); empty: all.
  int demonstrations = 60;
  planar::MethodOptions plane = {};  ///< Options for planar tasks.
  /// For guards. With features, methods may end in kOnPictures, and conditions disturb pictures.
  PictureOptions pictures = {};
};

/// Strategies of guards. Studies of guards or controllers also accept PlaceboNames().
[[nodiscard]] const std::vector<std::string>& GuardNames();

/// Checks of one word of a study's tasks, conditions, policies or controllers. `pictures` accepts
/// guards that end in kOnPictures.
/// @throws std::invalid_argument listing the valid names for an unknown one, naming --pictures if a
///   guard needs it, and as CheckKind().
void CheckTasks(Kind kind, const std::string& word);
void CheckCondition(const std::string& name);
void CheckPolicy(Kind kind, const std::string& name);
void CheckController(Kind kind, const std::string& name, bool pictures);

/// Counts of episodes, of one trial or of all trials of a Row.
struct TrialCounts {
  int episodes = 0;
  int completed = 0;
  int collided = 0;  ///< Includes collisions after a halt in a world that continues to move.
  int halted = 0;
  /// Number of start states from which the policy alone collides and this method does not.
  int saved = 0;
  /// Number of start states from which the policy alone completes and this method does not.
  int harmed = 0;
  int intervened = 0;            ///< Number of episodes that Intervened() accepts.
  int intervened_completed = 0;  ///< Number of these episodes that complete.
  int left_alone = 0;            ///< Number of all other episodes.
  int left_alone_completed = 0;  ///< Number of the other episodes that complete.
  double controls = 0.0;         ///< Number of controls in all episodes.
  double changed = 0.0;          ///< Number of controls that differ from the policy's.
  int alarmed_failures = 0;      ///< Number of collisions after an alarm; monitors only.
  int alarmed_successes = 0;     ///< Number of completions with an alarm; monitors only.
  bool operator==(const TrialCounts&) const = default;
  TrialCounts& operator+=(const TrialCounts& other) noexcept;
};

/// Returns true if the method changed a control of the episode at least once, or halted it for a
/// reason other than the end of its time, a limit on controls, or the plant. In both cases an
/// action of the policy is not applied.
[[nodiscard]] bool Intervened(const experiment::EpisodeResult& episode);

/// One method around one policy, in one task under one condition, over all trials.
struct Row : TrialCounts {
  std::string task;
  std::string condition;
  std::string policy;
  std::string controller;
  int saved_completed = 0;           ///< Number of saved episodes that this method completes.
  std::vector<int> recoveries = {};  ///< Number of controls of each recovery, in planar tasks only.
  /// Number of episodes by cause: "halted: no-progress", or "failed: " and the source of the
  /// control that collided.
  std::map<std::string, int> causes = {};
  /// Sum of control::Step::change over changed controls that have this value.
  double change = 0.0;
  int sized_changes = 0;                 ///< Number of these changed controls.
  std::vector<TrialCounts> trials = {};  ///< [trial]
  bool operator==(const Row&) const = default;
};

/// Runs the study, with a progress bar and a ledger in study.out unless that is empty, and resumes
/// an interrupted run. Rows come in the order of tasks, conditions, policies and controllers, the
/// policy alone first. They do not depend on the number of threads. A shard returns no rows.
/// @throws std::invalid_argument listing the valid names for an unknown one; and as
///   experiment::Evaluate() does.
[[nodiscard]] std::vector<Row> RunStudy(const Study& study);

/// Records the first `count` demonstrations of the first trial of a study of guards in one task as
/// "demonstrations", then its first `count` episodes of each method with the first policy.
/// @throws std::invalid_argument as RunStudy() does.
[[nodiscard]] std::vector<experiment::FilmedEpisode> RecordStudy(const Study& study, int count);

/// Two methods, in the notation of study::ParseMethod(), in one task under one condition.
struct Comparison {
  std::string task = "pusher";
  std::string condition = "as demonstrated";
  std::string first = "controller@lwr";
  std::string second = "lwr";
  int demonstrations = 60;
  /// Number of trials with separate demonstrations and policies. Pair i runs in trial i % trials.
  int trials = 5;
  int pairs = 1000;  ///< Maximum number of pairs.
  double alpha = 0.05;
  experiment::EpisodeCredit credit = {};
  std::uint64_t seed = 4711;
};

/// Runs pairs of episodes from the same start states until the difference of their credits is
/// significant, or Comparison::pairs are run. Start states outside the support are not replaced.
/// @throws std::invalid_argument listing the valid names for an unknown one.
[[nodiscard]] experiment::SequentialTest Compare(const Comparison& comparison);

}  // namespace dfr::study
