#include "apps/stress/study.h"

#include <algorithm>
#include <fstream>
#include <map>
#include <set>
#include <stdexcept>
#include <utility>

#include "dfr/control/phase_tracker.h"
#include "dfr/core/contract.h"
#include "dfr/core/format.h"
#include "dfr/core/random.h"
#include "dfr/experiment/episodes.h"
#include "dfr/experiment/rollout_runner.h"
#include "dfr/study/shared_cache.h"

namespace dfr::study::stress {
namespace {

constexpr const char* kAlone = "baseline";
constexpr const char* kLearned = "learned";
constexpr const char* kBetween = ": ";  // task and condition in a learner's name

std::string MethodOf(const std::string& controller, const std::string& policy) {
  if (policy == kLearned) return controller;
  const std::size_t slash = std::min(controller.find('/'), controller.size());
  return controller.substr(0, slash) + "@" + policy + controller.substr(slash);
}

// How far an episode came: the latest time step of the demonstrations whose support an observed
// state was in.
class Progress final : public control::RolloutObserver {
 public:
  explicit Progress(const core::LogDecisionFunction& support)
      : tracker_(support), last_(support.num_steps() - 1) {}
  void OnStart(std::span<const double> x) override { Follow(x); }
  void OnControl(const control::RolloutEvent& event) override { Follow(event.next_x); }
  // As a share of the last one.
  [[nodiscard]] double share() const {
    return last_ > 0 ? static_cast<double>(reached_) / static_cast<double>(last_) : 1.0;
  }

 private:
  void Follow(std::span<const double> x) {
    if (tracker_.Follow(x) >= 0.0) reached_ = std::max(reached_, tracker_.phase());
  }

  control::PhaseTracker tracker_;
  int last_;
  int reached_ = 0;
};

class Runner final : public experiment::RolloutRunner {
 public:
  Runner(const Task& task, const Variant& variant, const Condition& condition,
         std::shared_ptr<const LearnedModel> model, const std::vector<std::string>& methods)
      : RolloutRunner(variant.make(), WithNoise(condition, task)),
        aftermath_(task.aftermath),
        draw_(task.draw),
        model_(std::move(model)) {
    for (const std::string& method : methods) {
      Add(method, model_->controllers().Make(method, &driven(), task.controllers));
    }
  }

  // A video where the task has pictures, and the file is not to be a page of paths.
  bool Film(const std::vector<int>& methods, std::uint64_t start_seed,
            std::uint64_t controller_seed, const std::filesystem::path& path) override {
    if (!draw_ || path.extension() == ".html") {
      return RolloutRunner::Film(methods, start_seed, controller_seed, path);
    }
    const Drawing drawing = draw_(world());
    std::vector<apps::RolloutVideo> videos;
    videos.reserve(methods.size());
    for (const int method : methods) {
      apps::RolloutVideoRecorder recorder(MethodName(method), drawing.width, drawing.height,
                                          drawing.draw, model_->task().support());
      Watch(method, start_seed, controller_seed, &recorder);
      videos.push_back(recorder.Take());
    }
    apps::WriteVideo(path, videos);
    return true;
  }

  // What one episode is worth.
  double Credit(int method, std::uint64_t start_seed, std::uint64_t controller_seed,
                const experiment::EpisodeCredit& credit) {
    Progress progress(model_->task().guided_support());
    const auto episode = ResultOf(Watch(method, start_seed, controller_seed, &progress));
    return credit(episode.outcome, progress.share());
  }

 private:
  static control::DisturbanceOptions WithNoise(const Condition& condition, const Task& task) {
    control::DisturbanceOptions disturbance = condition.disturbance;
    disturbance.observation_noise = condition.noise * task.length;
    return disturbance;
  }

  [[nodiscard]] bool Inside(std::span<const double> /*x*/) const override { return true; }
  [[nodiscard]] bool CollidesAfterHalt() override {
    if (aftermath_) aftermath_(world());
    return world().collided();
  }

  std::function<void(core::SimulatedPlant&)> aftermath_;
  std::function<Drawing(const core::SimulatedPlant&)> draw_;
  std::shared_ptr<const LearnedModel> model_;
};

// What a learner's name stands for.
struct Place {
  const Task* task;
  const Variant* variant;
  const Condition* condition;
};

std::map<std::string, Place> Places(const std::vector<std::string>& wanted,
                                    const std::vector<Task>& tasks,
                                    std::vector<std::string>& names) {
  std::set<std::string> unknown(wanted.begin(), wanted.end());
  std::string known;
  std::map<std::string, Place> places;
  for (const Condition& condition : Conditions()) {
    unknown.erase(condition.name);
    known.append(known.empty() ? "" : ", ").append(condition.name);
  }
  DFR_THROW_UNLESS(unknown.empty(),
                   "there is no condition '" << *unknown.begin() << "'; there are " << known);
  for (const Task& task : tasks) {
    for (const Condition& condition : Conditions()) {
      if (!wanted.empty() && std::ranges::count(wanted, condition.name) == 0) {
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

double Share(int count, int of) { return 100.0 * count / of; }

// The row's place in ids. Empty for a sum over tasks and conditions.
std::string LearnerOf(const Row& row) {
  return row.task.empty() ? "" : row.task + kBetween + row.condition;
}

// Which command prints the row's episodes of these outcomes, from start states from which the
// policy alone ended with one of `alone`.
std::string CommandOf(const Row& row, const std::vector<std::string>& outcomes,
                      const std::vector<std::string>& alone = {}) {
  experiment::EpisodeFilter filter{.method = MethodOf(row.controller, row.policy),
                                   .learner = LearnerOf(row),
                                   .outcomes = outcomes};
  if (!alone.empty()) {
    filter.against = {.method = MethodOf(kAlone, row.policy), .outcomes = alone};
  }
  return experiment::EpisodesCommand("stress", filter);
}

std::string SavedCommand(const Row& row) {
  return CommandOf(row, {"completed", "halted"}, {"collided"});
}

std::string HarmedCommand(const Row& row) {
  return CommandOf(row, {"halted", "collided"}, {"completed"});
}

// The commands of the two numbers of Outcomes(), and of those of Compared().
std::string OutcomesCommand(const Row& row) {
  return CommandOf(row, {"completed"}) + "\n" + CommandOf(row, {"collided"});
}

std::string ComparedCommand(const Row& row) {
  return SavedCommand(row) + "\n" + HarmedCommand(row);
}

std::string Outcomes(const Row& row) {
  return core::Format("%.1f / %.1f", Share(row.completed, row.episodes),
                      Share(row.collided, row.episodes));
}

std::string Compared(const Row& row) {
  return core::Format("%.1f / %.1f", Share(row.saved, row.episodes),
                      Share(row.harmed, row.episodes));
}

template <typename Member>
std::vector<std::string> Distinct(const std::vector<Row>& rows, Member member) {
  std::vector<std::string> values;
  for (const Row& row : rows) {
    if (std::ranges::count(values, row.*member) == 0) values.push_back(row.*member);
  }
  return values;
}

experiment::ReportTable PolicyTable(const std::vector<Row>& rows, const std::string& policy,
                                    const std::vector<std::string>& controllers) {
  experiment::ReportTable table;
  table.heading = "Policy: " + policy;
  table.caption =
      "Completed / collided, then saved / harmed against the policy alone, in per cent of " +
      std::to_string(rows.front().episodes) + " episodes a cell.";
  table.header = {"task", "condition"};
  for (const std::string& controller : controllers) {
    table.header.push_back(controller == kAlone ? "alone" : controller);
    if (controller != kAlone) table.header.emplace_back("saved / harmed");
  }
  for (const Row& row : rows) {
    if (row.policy != policy) continue;
    if (row.controller == kAlone) {
      table.rows.push_back({row.task, row.condition});
      table.commands.push_back({"", ""});
    }
    table.rows.back().push_back(Outcomes(row));
    table.commands.back().push_back(OutcomesCommand(row));
    if (row.controller == kAlone) continue;
    table.rows.back().push_back(Compared(row));
    table.commands.back().push_back(ComparedCommand(row));
  }
  return table;
}

experiment::ReportTable MeansTable(const std::vector<Row>& rows,
                                   const std::vector<std::string>& policies,
                                   const std::vector<std::string>& controllers) {
  experiment::ReportTable table;
  table.heading = "Over all rows";
  table.caption = "Means in per cent, and the worst row of each.";
  table.header = {"policy", "controller", "completed",       "collided",
                  "saved",  "harmed",     "most collisions", "most harm"};
  for (const std::string& policy : policies) {
    for (const std::string& controller : controllers) {
      Row sum{.task = "", .condition = "", .policy = policy, .controller = controller};
      const Row* collides = nullptr;
      const Row* harms = nullptr;
      for (const Row& row : rows) {
        if (row.policy != policy || row.controller != controller) continue;
        sum.episodes += row.episodes;
        sum.completed += row.completed;
        sum.collided += row.collided;
        sum.saved += row.saved;
        sum.harmed += row.harmed;
        if (collides == nullptr || row.collided > collides->collided) collides = &row;
        if (harms == nullptr || row.harmed > harms->harmed) harms = &row;
      }
      const auto text = [&](int count) { return core::Format("%.2f", Share(count, sum.episodes)); };
      const auto worst = [](const Row& row, int count) {
        return core::Format("%.1f %s%s%s", Share(count, row.episodes), row.task.c_str(), kBetween,
                            row.condition.c_str());
      };
      table.rows.push_back({policy, controller == kAlone ? "alone" : controller,
                            text(sum.completed), text(sum.collided), text(sum.saved),
                            text(sum.harmed), worst(*collides, collides->collided),
                            worst(*harms, harms->harmed)});
      const bool alone = controller == kAlone;
      table.commands.push_back({"", "", CommandOf(sum, {"completed"}), CommandOf(sum, {"collided"}),
                                alone ? "" : SavedCommand(sum), alone ? "" : HarmedCommand(sum),
                                CommandOf(*collides, {"collided"}),
                                alone ? "" : HarmedCommand(*harms)});
    }
  }
  return table;
}

}  // namespace

std::vector<Row> RunStudy(const Study& study) {
  std::vector<Task> tasks;
  for (const std::string& name : study.tasks) tasks.push_back(MakeTask(name));
  std::vector<std::string> controllers = {kAlone};
  for (const std::string& name : study.controllers) {
    if (name != kAlone) controllers.push_back(name);
  }
  experiment::EvaluationPlan plan;
  const std::map<std::string, Place> places = Places(study.conditions, tasks, plan.learners);
  for (const std::string& policy : study.policies) {
    for (const std::string& controller : controllers) {
      plan.methods.push_back(MethodOf(controller, policy));
      static_cast<void>(ParseMethod(plan.methods.back()));
    }
  }
  plan.demonstrations = {study.demonstrations};
  plan = experiment::ApplyTo(std::move(plan), study);

  SharedCache<std::pair<std::string, int>, LearnedModel> models;
  const auto make = [&](const experiment::EvaluationUnit& unit) {
    const Place& place = places.at(unit.learner);
    auto model = models.Get({place.task->name, unit.trial}, [&] {
      return place.task->learn(
          unit.demonstrations,
          core::DeriveSeed(plan.seed, {2, static_cast<std::uint64_t>(unit.trial)}));
    });
    return std::make_unique<Runner>(*place.task, *place.variant, *place.condition, std::move(model),
                                    plan.methods);
  };
  const experiment::OutputFolder folder(study);
  const auto found = experiment::RunExperiment("stress", plan, make, {}, study);
  std::vector<Row> rows;
  if (!found) return rows;
  const std::vector<experiment::UnitResult>& units = found->units;

  for (const std::string& learner : plan.learners) {
    const Place& place = places.at(learner);
    for (std::size_t p = 0; p < study.policies.size(); ++p) {
      const std::size_t alone = p * controllers.size();
      for (std::size_t c = 0; c < controllers.size(); ++c) {
        Row row{place.task->name, place.condition->name, study.policies[p], controllers[c]};
        for (const experiment::UnitResult& unit : units) {
          if (unit.unit.learner != learner) continue;
          for (std::size_t i = 0; i < unit.starts.size(); ++i) {
            using core::Outcome;
            const Outcome without = unit.episodes[alone][i].outcome;
            const Outcome with = unit.episodes[alone + c][i].outcome;
            ++row.episodes;
            row.completed += with == Outcome::kCompleted ? 1 : 0;
            row.collided += with == Outcome::kCollided ? 1 : 0;
            row.saved += without == Outcome::kCollided && with != Outcome::kCollided ? 1 : 0;
            row.harmed += without == Outcome::kCompleted && with != Outcome::kCompleted ? 1 : 0;
          }
        }
        rows.push_back(std::move(row));
      }
    }
  }
  return rows;
}

experiment::SequentialTest Compare(const Comparison& comparison) {
  DFR_THROW_UNLESS(comparison.trials > 0 && comparison.pairs > 0,
                   "a comparison needs a trial and a pair of episodes");
  const std::vector<Task> tasks = {MakeTask(comparison.task)};
  std::vector<std::string> names;
  const auto places = Places({comparison.condition}, tasks, names);
  DFR_THROW_UNLESS(!names.empty(), "task '" << comparison.task << "' has no condition '"
                                            << comparison.condition << "'");
  const Place& place = places.at(names.front());
  const std::vector<std::string> methods = {comparison.first, comparison.second};
  for (const std::string& method : methods) static_cast<void>(ParseMethod(method));
  experiment::SequentialTest test(comparison.alpha);
  std::vector<std::unique_ptr<Runner>> runners;
  for (std::uint64_t i = 0; i < static_cast<std::uint64_t>(comparison.pairs); ++i) {
    const std::uint64_t trial = i % static_cast<std::uint64_t>(comparison.trials);
    if (trial == runners.size()) {
      runners.push_back(std::make_unique<Runner>(
          *place.task, *place.variant, *place.condition,
          std::make_shared<const LearnedModel>(place.task->learn(
              comparison.demonstrations, core::DeriveSeed(comparison.seed, {2, trial}))),
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

std::vector<experiment::ReportTable> MakeTables(const std::vector<Row>& rows) {
  std::vector<experiment::ReportTable> tables;
  if (rows.empty()) return tables;
  const std::vector<std::string> policies = Distinct(rows, &Row::policy);
  const std::vector<std::string> controllers = Distinct(rows, &Row::controller);
  for (const std::string& policy : policies) {
    tables.push_back(PolicyTable(rows, policy, controllers));
  }
  tables.push_back(MeansTable(rows, policies, controllers));
  return tables;
}

std::vector<experiment::ReportTable> MakeGrid(const std::vector<Row>& rows) {
  std::vector<experiment::ReportTable> tables;
  for (const std::string& policy : Distinct(rows, &Row::policy)) {
    std::vector<std::string> names;
    std::vector<std::string> supports;
    std::map<std::pair<std::string, std::string>, Row> sums;  // by support and controller
    for (const Row& row : rows) {
      if (row.policy != policy) continue;
      const std::size_t slash = std::min(row.controller.find('/'), row.controller.size());
      const std::string name = row.controller.substr(0, slash);
      const std::string support =
          slash < row.controller.size() ? row.controller.substr(slash + 1) : "";
      if (std::ranges::count(names, name) == 0) names.push_back(name);
      if (!support.empty() && std::ranges::count(supports, support) == 0) {
        supports.push_back(support);
      }
      Row& sum = sums[{support, name}];
      sum.policy = row.policy;
      sum.controller = row.controller;
      sum.episodes += row.episodes;
      sum.completed += row.completed;
      sum.collided += row.collided;
    }
    experiment::ReportTable table{
        .heading = "Support and controller, policy: " + policy,
        .caption = "Completed / collided in per cent, means over all tasks and conditions.",
        .header = {"support"},
        .rows = {}};
    for (const std::string& name : names) table.header.push_back(name == kAlone ? "alone" : name);
    for (const std::string& support : supports) {
      table.rows.push_back({support});
      table.commands.push_back({""});
      for (const std::string& name : names) {
        // The policy alone looks at no support.
        const auto sum = sums.find({name == kAlone ? "" : support, name});
        table.rows.back().push_back(sum == sums.end() ? "-" : Outcomes(sum->second));
        table.commands.back().push_back(sum == sums.end() ? "" : OutcomesCommand(sum->second));
      }
    }
    tables.push_back(std::move(table));
  }
  return tables;
}

experiment::ReportTable WhereItFails(const std::vector<Row>& rows, const std::string& controller) {
  constexpr double kMostCollided = 0.5;
  constexpr double kMostHarmed = 2.0;
  experiment::ReportTable table;
  table.heading = "Where " + controller + " fails around a policy that completes half or more";
  table.caption = "It collides in more than 0.5 % of the episodes, or harms more than 2 %.";
  table.header = {"task", "condition", "policy", "alone", "guarded", "saved / harmed"};
  const Row* alone = nullptr;
  for (const Row& row : rows) {
    if (row.controller == kAlone) alone = &row;
    if (row.controller != controller || alone == nullptr) continue;
    if (2 * alone->completed < alone->episodes) continue;
    if (Share(row.collided, row.episodes) <= kMostCollided &&
        Share(row.harmed, row.episodes) <= kMostHarmed) {
      continue;
    }
    table.rows.push_back(
        {row.task, row.condition, row.policy, Outcomes(*alone), Outcomes(row), Compared(row)});
    table.commands.push_back(
        {"", "", "", OutcomesCommand(*alone), OutcomesCommand(row), ComparedCommand(row)});
  }
  return table;
}

void SaveCsv(const std::vector<Row>& rows, const std::filesystem::path& path) {
  std::ofstream out(path);
  out << "task,condition,policy,controller,episodes,completed,collided,saved,harmed\n";
  for (const Row& row : rows) {
    out << row.task << ',' << row.condition << ',' << row.policy << ',' << row.controller << ','
        << row.episodes << ',' << row.completed << ',' << row.collided << ',' << row.saved << ','
        << row.harmed << '\n';
  }
  if (!out.flush()) throw std::runtime_error(path.string() + ": cannot be written");
}

}  // namespace dfr::study::stress
