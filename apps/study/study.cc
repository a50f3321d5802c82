#include "apps/study/study.h"

#include <algorithm>
#include <array>
#include <map>
#include <memory>
#include <string_view>
#include <utility>

#include "apps/study/imitator.h"
#include "apps/study/runner.h"
#include "apps/study/tables.h"
#include "apps/usage_error.h"
#include "dfr/control/controller.h"
#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "dfr/core/text/suggest.h"
#include "dfr/experiment/film.h"
#include "dfr/experiment/ledger.h"
#include "dfr/safety/guard.h"
#include "dfr/study/placebo.h"

namespace dfr::study {
namespace {

void CheckName(const char* what, const std::string& name, const std::vector<std::string>& known) {
  if (std::ranges::count(known, name) == 0) throw core::UnknownName(what, name, Join(known));
}

bool IsAlone(const std::string& controller) {
  return controller == kAlone || controller == "alone";
}

// Throws if a task cannot be drawn.
void CheckPictures(const Task& task) {
  if (task.small != nullptr && HasPictures(*task.small->plant)) return;
  std::vector<std::string> drawn;
  for (const sim::GalleryTask& other : sim::GalleryTasks()) {
    if (HasPictures(*other.plant)) drawn.push_back(other.name);
  }
  throw apps::UsageError("--pictures: task '" + task.name +
                         "' has no pictures; valid: " + Join(drawn));
}

std::map<std::string, Place> Places(const std::vector<std::string>& wanted,
                                    const std::vector<Task>& tasks,
                                    std::vector<std::string>& names) {
  for (const std::string& name : wanted) CheckCondition(name);
  std::map<std::string, Place> places;
  for (const Task& task : tasks) {
    for (const Condition& condition : Conditions()) {
      if (wanted.empty() ? condition.on_request : std::ranges::count(wanted, condition.name) == 0) {
        continue;
      }
      const auto variant = std::ranges::find(task.variants, condition.variant, &Variant::name);
      if (variant == task.variants.end()) continue;
      names.push_back(task.name + kBetween + condition.name);
      places[names.back()] = {&task, &*variant, &condition};
    }
  }
  return places;
}

// Units of a study, and their shared data.
class Units {
 public:
  explicit Units(const Study& study) : study_(study) {
    for (const std::string& name : SelectTasks(study.tasks)) {
      tasks_.push_back(MakeTask(name));
      CheckKind(tasks_.back(), study.kind);
    }
    places_ = Places(study.conditions, tasks_, plan_.learners);
    if (places_.empty()) {
      throw apps::UsageError("--conditions: none of the chosen tasks has any of the conditions " +
                             Join(study.conditions) + "; choose other tasks or conditions");
    }
    for (const std::string& name : study.controllers) {
      apps::ValueOf("--methods",
                    [&] { CheckController(study.kind, name, !study.pictures.features.empty()); });
      if (!IsAlone(name)) controllers_.push_back(name);
    }
    for (const std::string& name : study.policies) CheckPolicy(study.kind, name);
    for (const auto& [name, place] : places_) {
      const bool disturbed = place.condition->nuisances != Nuisances{};
      if (disturbed && study.pictures.features.empty()) {
        throw apps::UsageError("--conditions: '" + place.condition->name +
                               "' disturbs pictures: add --pictures points:image, and a method "
                               "such as guard/pictures");
      }
      if (!study.pictures.features.empty()) CheckPictures(*place.task);
    }
    if (study.kind != Kind::kPlane) {
      apps::ValueOf("--methods", [&] { CheckPlacebos(controllers_); });
    }
    controllers_.insert(controllers_.begin(), kAlone);
    for (const std::string& policy : study.policies) {
      for (const std::string& controller : controllers_) {
        plan_.methods.push_back(MethodOf(controller, policy));
        if (controller != kAlone && IsPolicy(controller)) {
          plan_.policies.push_back(plan_.methods.back());
        }
        if (study.kind == Kind::kGuards) continue;
        // Some controllers take no other policy.
        apps::ValueOf("--policies, --methods",
                      [&] { CheckController(study.kind, plan_.methods.back(), false); });
      }
    }
    plan_.demonstrations = {study.demonstrations};
    plan_ = experiment::ApplyTo(std::move(plan_), study);
  }

  [[nodiscard]] const experiment::EvaluationPlan& plan() const { return plan_; }
  [[nodiscard]] const std::vector<std::string>& controllers() const { return controllers_; }
  [[nodiscard]] const Place& PlaceOf(const std::string& learner) const {
    return places_.at(learner);
  }
  [[nodiscard]] std::shared_ptr<const Prepared> PreparedFor(
      const experiment::EvaluationUnit& unit) {
    const Place& place = PlaceOf(unit.learner);
    const int count = place.condition->CountOr(unit.demonstrations);
    return prepared_.Get({place.task->name + "/" + std::to_string(count), unit.trial}, [&] {
      return Prepare(*place.task, study_.kind, count, plan_.seed, unit.trial, study_.plane,
                     study_.pictures);
    });
  }
  [[nodiscard]] std::unique_ptr<Runner> Make(const experiment::EvaluationUnit& unit) {
    auto runner = std::make_unique<Runner>(PlaceOf(unit.learner), PreparedFor(unit), plan_.methods);
    runner->JudgeIn(plan_, unit);
    return runner;
  }
  void CheckFilm(const experiment::EvaluationUnit& unit, const std::filesystem::path& film) const {
    const Place& place = PlaceOf(unit.learner);
    if (!place.task->draw || film.extension() == ".html") return experiment::CheckPage(film);
    const auto world = place.variant->make();
    world->Reset(0);
    const Drawing drawing = place.task->draw(*world);
    apps::CheckVideo(film, drawing.width, drawing.height, drawing.draw);
  }

 private:
  const Study& study_;
  std::vector<Task> tasks_;
  std::map<std::string, Place> places_;
  std::vector<std::string> controllers_;
  experiment::EvaluationPlan plan_;
  PreparedCache prepared_;
};

const char* NameOf(Kind kind) {
  switch (kind) {
    case Kind::kControllers:
      return "stress";
    case Kind::kGuards:
      return "guards";
    case Kind::kPlane:
      break;
  }
  return "planar";
}

std::map<std::string, std::string> SettingsOf(const Study& study) {
  using experiment::Exactly;
  std::map<std::string, std::string> settings = {{"kind", NameOf(study.kind)}};
  if (!study.pictures.features.empty()) {
    settings.insert({{"pictures", study.pictures.features},
                     {"light", Exactly(study.pictures.shown.light)},
                     {"noise", Exactly(study.pictures.shown.noise)}});
  } else if (study.kind == Kind::kPlane) {
    settings.insert({{"gamma", Exactly(study.plane.gamma)},
                     {"raw gamma", Exactly(study.plane.raw_gamma)},
                     {"certified level", Exactly(study.plane.certified_level)},
                     {"factor", Exactly(study.plane.error_factor)}});
  }
  return settings;
}

void AddUnit(const experiment::UnitResult& unit, std::size_t alone, std::size_t method,
             const std::string& name, Row& row) {
  using core::Outcome;
  TrialCounts& trial = row.trials.at(static_cast<std::size_t>(unit.unit.trial));
  for (std::size_t i = 0; i < unit.starts.size(); ++i) {
    const Outcome without = unit.episodes[alone][i].outcome;
    const experiment::EpisodeResult& episode = unit.episodes[method][i];
    const bool completed = episode.outcome == Outcome::kCompleted;
    const bool collided = episode.outcome == Outcome::kCollided;
    ++trial.episodes;
    trial.completed += completed ? 1 : 0;
    trial.collided += collided ? 1 : 0;
    trial.halted += completed || collided ? 0 : 1;
    trial.saved += without == Outcome::kCollided && !collided ? 1 : 0;
    trial.harmed += without == Outcome::kCompleted && !completed ? 1 : 0;
    const bool intervened = Intervened(episode);
    trial.intervened += intervened ? 1 : 0;
    trial.intervened_completed += intervened && completed ? 1 : 0;
    trial.left_alone += intervened ? 0 : 1;
    trial.left_alone_completed += !intervened && completed ? 1 : 0;
    trial.controls += episode.controls;
    trial.changed += episode.changed_controls;
    row.saved_completed += without == Outcome::kCollided && completed ? 1 : 0;
    row.change += episode.change;
    row.sized_changes += episode.sized_changes;
    if (!completed) ++row.causes[(collided ? "failed: " : "halted: ") + episode.cause];
  }
  const auto alarms = [&](Outcome outcome) {
    const auto measure = unit.measures.find(AlarmsIn(outcome, name));
    return measure == unit.measures.end() ? 0 : static_cast<int>(measure->second);
  };
  const auto counts = unit.counts.find(name);
  if (counts != unit.counts.end()) {
    row.recoveries.insert(row.recoveries.end(), counts->second.begin(), counts->second.end());
  }
  trial.alarmed_failures += alarms(Outcome::kCollided);
  trial.alarmed_successes += alarms(Outcome::kCompleted);
  row += trial;
}

}  // namespace

Study Study::OfGuards() {
  Study study;
  study.out.clear();
  study.seed = 1;
  study.episodes = 100;
  study.kind = Kind::kGuards;
  study.tasks = {"gallery"};
  study.policies = {"good", "weak", "biased", "lwr", "lwr-cv", "lwr-online", "knn", "none"};
  study.controllers = GuardNames();
  study.controllers.insert(study.controllers.end(), PlaceboNames().begin(), PlaceboNames().end());
  study.conditions = {"as demonstrated"};
  return study;
}

Study Study::OfPlane() {
  Study study;
  study.out.clear();
  study.seed = 1;
  study.trials = 10;
  study.episodes = 100;
  study.kind = Kind::kPlane;
  study.tasks = {"planar-corridor"};
  study.policies = {"learned"};
  study.controllers = {"early-stopping", "dfr",  "controller", "true-jacobian",      "lwr", "knn",
                       "ensemble",       "dart", "dagger",     "certified-direction"};
  study.conditions = {"as demonstrated"};
  study.demonstrations = 120;
  return study;
}

const std::vector<std::string>& GuardNames() {
  using safety::Strategy;
  static const std::vector<std::string> names = {
      Name(Strategy::kMonitor), Name(Strategy::kEarlyStopping), Name(Strategy::kDfr),
      Name(Strategy::kGuard),   Name(Strategy::kController),    Name(Strategy::kCertified)};
  return names;
}

void CheckTasks(Kind kind, const std::string& word) {
  for (const std::string& name : SelectTasks({word})) CheckKind(MakeTask(name), kind);
}

void CheckCondition(const std::string& name) {
  std::vector<std::string> known;
  for (const Condition& condition : Conditions()) known.push_back(condition.name);
  CheckName("condition", name, known);
}

void CheckPolicy(Kind kind, const std::string& name) {
  std::vector<std::string> known = {"learned"};
  known.insert(known.end(), kPolicies.begin(), kPolicies.end());
  CheckName("policy", name, kind == Kind::kGuards ? PolicyNames() : known);
}

void CheckController(Kind kind, const std::string& name, bool pictures) {
  if (IsAlone(name)) return;
  if (kind == Kind::kControllers) {
    static_cast<void>(ParseCompared(name));
  } else if (kind == Kind::kPlane) {
    static_cast<void>(ParseMethod(name, planar::kPlanarMethods));
  } else {
    if (!pictures && name.ends_with(kOnPictures)) {
      throw std::invalid_argument("method '" + name +
                                  "' needs pictures: add --pictures, such as points:image, to "
                                  "`study run`");
    }
    std::vector<std::string> known = GuardNames();
    for (const std::string& guard : GuardNames()) {
      if (pictures) known.push_back(guard + kOnPictures);
    }
    known.insert(known.end(), PlaceboNames().begin(), PlaceboNames().end());
    CheckName("method", name, known);
  }
}

bool Intervened(const experiment::EpisodeResult& episode) {
  using control::HaltCause;
  if (episode.changed_controls > 0) return true;
  // Prefix of the cause of a collision after a halt: "after <cause of the halt>".
  constexpr std::string_view kAfter = "after ";
  std::string_view cause = episode.cause;
  if (cause.starts_with(kAfter)) {
    cause.remove_prefix(kAfter.size());
  } else if (episode.outcome != core::Outcome::kHalted) {
    return false;
  }
  return std::ranges::none_of(std::array{HaltCause::kTimeUp, HaltCause::kControlLimit,
                                         HaltCause::kPlantRefused, HaltCause::kPlantFault},
                              [cause](HaltCause other) { return cause == control::Name(other); });
}

std::vector<Row> RunStudy(const Study& study) {
  Units units(study);
  const experiment::EvaluationPlan& plan = units.plan();
  const std::vector<std::string>& controllers = units.controllers();
  apps::ValueOf("--tasks, --policies, --conditions, --methods",
                [&plan] { experiment::CheckPlan(plan); });
  const experiment::OutputFolder folder(study, plan);
  const auto found = experiment::RunExperiment(
      NameOf(study.kind), plan,
      [&](const experiment::EvaluationUnit& unit) { return units.Make(unit); }, SettingsOf(study),
      study,
      [&](const experiment::EvaluationUnit& unit, const std::filesystem::path& film) {
        units.CheckFilm(unit, film);
      });
  std::vector<Row> rows;
  if (!found) return rows;
  for (const std::string& learner : plan.learners) {
    const Place& place = units.PlaceOf(learner);
    for (std::size_t method = 0; method < plan.methods.size(); ++method) {
      const std::size_t alone = method / controllers.size() * controllers.size();
      Row row{{},
              place.task->name,
              place.condition->name,
              study.policies[method / controllers.size()],
              controllers[method - alone]};
      row.trials.resize(static_cast<std::size_t>(plan.trials));
      for (const experiment::UnitResult& unit : found->units) {
        if (unit.unit.learner == learner) AddUnit(unit, alone, method, plan.methods[method], row);
      }
      rows.push_back(std::move(row));
    }
  }
  return rows;
}

std::vector<experiment::FilmedEpisode> RecordStudy(const Study& study, int count) {
  Units units(study);
  const experiment::EvaluationPlan& plan = units.plan();
  const experiment::EvaluationUnit unit{.demonstrations = study.demonstrations,
                                        .learner = plan.learners.front()};
  std::vector<experiment::FilmedEpisode> episodes;
  for (const core::Trajectory& demonstration : units.PreparedFor(unit)->demonstrations) {
    if (std::ssize(episodes) == count) break;
    experiment::FilmedEpisode& episode = episodes.emplace_back();
    episode.method = "demonstrations";
    episode.result.outcome = demonstration.outcome;
    episode.states = demonstration.states;
  }
  const auto runner = units.Make(unit);
  for (std::size_t method = 0; method < units.controllers().size(); ++method) {
    for (int i = 0; i < count; ++i) {
      const std::uint64_t start = experiment::StartSeed(plan, 0, i, 0);
      episodes.push_back(runner->RecordStates(static_cast<int>(method), start,
                                              experiment::ControllerSeed(plan, 0, i)));
      episodes.back().method = method > 0 ? units.controllers()[method] : "alone";
    }
  }
  return episodes;
}

experiment::SequentialTest Compare(const Comparison& comparison) {
  DFR_THROW_UNLESS(comparison.trials > 0 && comparison.pairs > 0,
                   "a comparison needs a trial and a pair of episodes");
  const std::vector<Task> tasks = {MakeTask(comparison.task)};
  std::vector<std::string> names;
  const auto places = Places({comparison.condition}, tasks, names);
  if (names.empty()) {
    throw apps::UsageError("--condition: task '" + comparison.task + "' has no condition '" +
                           comparison.condition + "'");
  }
  const Place& place = places.at(names.front());
  if (place.condition->nuisances != Nuisances{}) {
    throw apps::UsageError("--condition: '" + comparison.condition +
                           "' disturbs pictures, which no compared method receives");
  }
  const std::vector<std::string> methods = {comparison.first, comparison.second};
  for (const std::string& method : methods) static_cast<void>(ParseMethod(method));
  experiment::SequentialTest test(comparison.alpha);
  std::vector<std::unique_ptr<Runner>> runners;
  for (std::uint64_t i = 0; i < static_cast<std::uint64_t>(comparison.pairs); ++i) {
    const std::uint64_t trial = i % static_cast<std::uint64_t>(comparison.trials);
    if (trial == runners.size()) {
      runners.push_back(std::make_unique<Runner>(
          place,
          std::make_shared<const Prepared>(Prepare(
              *place.task, Kind::kControllers, place.condition->CountOr(comparison.demonstrations),
              comparison.seed, static_cast<int>(trial))),
          methods));
    }
    const std::uint64_t start = core::DeriveSeed(comparison.seed, {0, i});
    const std::uint64_t controller = core::DeriveSeed(comparison.seed, {1, i});
    const auto credit = [&](int method) {
      return runners[trial]->Credit(method, start, controller, comparison.credit);
    };
    const double first = credit(0);
    test.Add(first - credit(1));
    if (test.settled()) break;
  }
  return test;
}

}  // namespace dfr::study
