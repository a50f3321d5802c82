#include "apps/gallery/study.h"

#include <algorithm>
#include <fstream>
#include <map>
#include <memory>
#include <ostream>
#include <stdexcept>
#include <utility>

#include "apps/gallery/policies.h"
#include "dfr/core/contract.h"
#include "dfr/core/format.h"
#include "dfr/core/random.h"
#include "dfr/experiment/film.h"
#include "dfr/experiment/intervals.h"
#include "dfr/experiment/paired_evaluation.h"
#include "dfr/experiment/report.h"
#include "dfr/safety/guard.h"
#include "dfr/study/policies.h"
#include "dfr/study/shared_cache.h"

namespace dfr::study::gallery {
namespace {

// What all policies of a task in one trial share.
struct Prepared {
  std::vector<core::Trajectory> demonstrations;
  std::shared_ptr<const safety::GuardModel> model;
};

// Fits once for all units of a task and trial.
class Cache {
 public:
  explicit Cache(const Study& study) : study_(study) {}

  std::shared_ptr<const Prepared> Get(const sim::GalleryTask& task, int trial) {
    return cache_.Get({task.name, trial}, [&] {
      Prepared prepared;
      prepared.demonstrations =
          sim::Demonstrate(task, study_.demonstrations,
                           core::DeriveSeed(study_.seed, {2, static_cast<std::uint64_t>(trial)}));
      prepared.model = safety::GuardModel::Fit(task.plant->layout(), prepared.demonstrations,
                                               {.features = task.features});
      return prepared;
    });
  }

 private:
  const Study& study_;
  SharedCache<std::pair<std::string, int>, Prepared> cache_;
};

constexpr const char* kAlarmedFailures = "alarmed failures";
constexpr const char* kAlarmedSuccesses = "alarmed successes";

std::pair<std::string, std::string> Split(const std::string& learner) {
  const auto slash = learner.find('/');
  return {learner.substr(0, slash), learner.substr(slash + 1)};
}

class Runner final : public experiment::TrialRunner {
 public:
  Runner(const std::vector<std::string>& methods, const sim::GalleryTask& task,
         std::shared_ptr<const Prepared> prepared, const std::string& policy,
         std::uint64_t policy_seed)
      : names_(methods),
        task_(task),
        prepared_(std::move(prepared)),
        horizon_(prepared_->model->settings().horizon),
        plant_(task.plant->Clone()),
        policy_(Imitate(task, prepared_->demonstrations, prepared_->model->task(), *plant_, policy,
                        policy_seed)) {
    for (const std::string& method : methods) {
      if (method == "alone") {
        guards_.push_back(nullptr);
        continue;
      }
      safety::GuardSettings settings = prepared_->model->settings();
      settings.strategy = safety::ParseStrategy(method);
      guards_.push_back(std::make_unique<safety::Guard>(prepared_->model->With(settings)));
    }
    x_.resize(static_cast<std::size_t>(plant_->state_dim()));
    u_.resize(static_cast<std::size_t>(plant_->control_dim()));
  }

  bool Accepts(std::uint64_t) override { return true; }

  experiment::EpisodeResult Run(int method, std::uint64_t start_seed,
                                std::uint64_t controller_seed) override {
    safety::Guard* guard = guards_[static_cast<std::size_t>(method)].get();
    experiment::EpisodeResult result;
    bool alarm = false;
    const char* chooser = "policy";
    const auto over = [this] { return plant_->completed() || plant_->collided(); };
    plant_->Reset(start_seed);
    policy_.Reset(start_seed);
    if (guard != nullptr) guard->Reset(controller_seed);
    Observe();
    for (int t = 0; !over(); ++t) {
      if (guard == nullptr && t == horizon_) {
        result.cause = "time-up";
        break;
      }
      policy_.Control(t, x_, u_);
      bool recovers = false;
      if (guard != nullptr) {
        const safety::Verdict verdict = guard->Filter(t, x_, u_, u_);
        alarm = alarm || verdict.alarm;
        if (verdict.mode == control::Mode::kHalt) {
          result.cause = verdict.reason();
          break;
        }
        recovers = verdict.mode != control::Mode::kPolicy;
        if (recovers) ++result.recovery_controls;
        const bool unchanged = verdict.mode == control::Mode::kPolicy && !verdict.changed;
        chooser = unchanged ? "policy" : verdict.reason();
      }
      Apply();
      Observe();
      if (recovery_ != nullptr) recovery_->push_back(recovers);
      ++result.controls;
    }
    if (!over()) {
      std::fill(u_.begin(), u_.end(), 0.0);
      for (int t = 0; t < task_.aftermath && !plant_->collided(); ++t) Apply();
    }
    if (plant_->collided()) {
      result.outcome = core::Outcome::kCollided;
      result.cause = result.cause.empty() ? chooser : "after " + result.cause;
    } else if (plant_->completed() && result.cause.empty()) {
      result.outcome = core::Outcome::kCompleted;
    }
    if (guard != nullptr && guard->model().settings().strategy == safety::Strategy::kMonitor &&
        alarm) {
      if (result.outcome == core::Outcome::kCollided) ++alarmed_failures_;
      if (result.outcome == core::Outcome::kCompleted) ++alarmed_successes_;
    }
    return result;
  }

  /// A page of their paths.
  bool Film(const std::vector<int>& methods, std::uint64_t start_seed,
            std::uint64_t controller_seed, const std::filesystem::path& path) override {
    std::vector<experiment::FilmedEpisode> episodes;
    episodes.reserve(methods.size());
    for (const int method : methods) {
      episodes.push_back(Watch(method, start_seed, controller_seed));
    }
    experiment::SaveFilm(task_.name, plant_->layout(), episodes, path);
    return true;
  }

  /// Run(), and what it went through.
  experiment::FilmedEpisode Watch(int method, std::uint64_t start_seed,
                                  std::uint64_t controller_seed) {
    experiment::FilmedEpisode episode;
    std::vector<double> states;
    states_ = &states;
    recovery_ = &episode.recovery;
    episode.method = names_[static_cast<std::size_t>(method)];
    episode.result = Run(method, start_seed, controller_seed);
    states_ = nullptr;
    recovery_ = nullptr;
    const Eigen::Index width = plant_->state_dim();
    episode.states =
        Eigen::Map<const core::Matrix>(states.data(), std::ssize(states) / width, width);
    return episode;
  }

  std::map<std::string, double> Measures() override {
    return {{kAlarmedFailures, alarmed_failures_}, {kAlarmedSuccesses, alarmed_successes_}};
  }

 private:
  void Apply() {
    if (plant_->Apply(u_) != core::PlantStatus::kOk) {
      throw std::logic_error("the plant of '" + task_.name + "' refused a control");
    }
  }

  void Observe() {
    plant_->Observe(x_);
    if (states_ != nullptr) states_->insert(states_->end(), x_.begin(), x_.end());
  }

  std::vector<std::string> names_;
  const sim::GalleryTask& task_;
  std::shared_ptr<const Prepared> prepared_;
  int horizon_;
  std::unique_ptr<core::SimulatedPlant> plant_;
  Imitator policy_;
  std::vector<std::unique_ptr<safety::Guard>> guards_;  // null: the policy alone
  std::vector<double> x_;
  std::vector<double> u_;
  std::vector<double>* states_ = nullptr;  // where states go, one after another
  std::vector<bool>* recovery_ = nullptr;  // and whether a recovery chose the control
  int alarmed_failures_ = 0;
  int alarmed_successes_ = 0;
};

experiment::EvaluationPlan MakePlan(const Study& study) {
  experiment::EvaluationPlan plan;
  plan.methods = {"alone"};
  for (const std::string& method : study.methods) {
    DFR_THROW_UNLESS(std::ranges::count(MethodNames(), method) == 1,
                     "there is no method '" << method << "'; there are alone, monitor, "
                                            << "early-stopping, dfr, soft, guided, certified");
    if (method != "alone") plan.methods.push_back(method);
  }
  // Policies outside, so that threads fit different tasks at the same time.
  for (const std::string& policy : study.policies) {
    DFR_THROW_UNLESS(
        std::ranges::count(PolicyNames(), policy) == 1,
        "there is no policy '" << policy << "'; there are good, weak, biased, " << Join(kPolicies));
    for (const std::string& task : study.tasks) {
      plan.learners.push_back(sim::FindGalleryTask(task).name + "/" + policy);
    }
  }
  plan.demonstrations = {study.demonstrations};
  plan.trials = study.trials;
  plan.episodes = study.episodes;
  plan.seed = study.seed;
  return plan;
}

std::unique_ptr<Runner> MakeRunner(const experiment::EvaluationPlan& plan,
                                   const experiment::EvaluationUnit& unit, Cache& cache) {
  const auto [name, policy] = Split(unit.learner);
  const sim::GalleryTask& task = sim::FindGalleryTask(name);
  const auto trial = static_cast<std::uint64_t>(unit.trial);
  const auto prepared = cache.Get(task, unit.trial);
  return std::make_unique<Runner>(plan.methods, task, prepared, policy,
                                  core::DeriveSeed(plan.seed, {3, trial}));
}

void AddUnit(const experiment::UnitResult& unit, std::size_t method, Row& row) {
  using core::Outcome;
  for (std::size_t i = 0; i < unit.starts.size(); ++i) {
    const Outcome alone = unit.episodes[0][i].outcome;
    const experiment::EpisodeResult& episode = unit.episodes[method][i];
    const bool ok = episode.outcome == Outcome::kCompleted;
    const bool failed = episode.outcome == Outcome::kCollided;
    ++row.episodes;
    row.ok += ok ? 1 : 0;
    row.failed += failed ? 1 : 0;
    row.saved += alone == Outcome::kCollided && !failed ? 1 : 0;
    row.saved_ok += alone == Outcome::kCollided && ok ? 1 : 0;
    row.harmed += alone == Outcome::kCompleted && !ok ? 1 : 0;
    row.controls += episode.controls;
    if (!ok) ++row.causes[(failed ? "failed: " : "halted: ") + episode.cause];
  }
  if (row.method == Name(safety::Strategy::kMonitor)) {
    row.alarmed_failures += static_cast<int>(unit.measures.at(kAlarmedFailures));
    row.alarmed_successes += static_cast<int>(unit.measures.at(kAlarmedSuccesses));
  }
}

std::string Percent(int count, int of) {
  if (of == 0) return "-";
  const experiment::Interval i = experiment::ProportionInterval(count, of);
  return core::Format("%3.0f [%3.0f,%4.0f]", 100.0 * count / of, 100.0 * i.low, 100.0 * i.high);
}

}  // namespace

const std::vector<std::string>& MethodNames() {
  using safety::Strategy;
  static const std::vector<std::string> names = {"alone",
                                                 Name(Strategy::kMonitor),
                                                 Name(Strategy::kEarlyStopping),
                                                 Name(Strategy::kDfr),
                                                 Name(Strategy::kSoft),
                                                 Name(Strategy::kGuided),
                                                 Name(Strategy::kCertified)};
  return names;
}

std::vector<std::string> SelectTasks(const std::vector<std::string>& words) {
  std::vector<std::string> tasks;
  const auto add = [&](const std::string& name) {
    if (std::ranges::count(tasks, name) == 0) tasks.push_back(name);
  };
  for (const std::string& word : words) {
    if (word != "all" && word != "design" && word != "judgement") {
      add(sim::FindGalleryTask(word).name);
      continue;
    }
    for (const sim::GalleryTask& task : sim::GalleryTasks()) {
      if (word == "all" || task.judgement == (word == "judgement")) add(task.name);
    }
  }
  return tasks;
}

std::vector<Row> RunStudy(const Study& study) {
  const experiment::EvaluationPlan plan = MakePlan(study);
  Cache cache(study);
  const auto make = [&](const experiment::EvaluationUnit& unit) {
    return MakeRunner(plan, unit, cache);
  };
  std::vector<Row> rows;
  const experiment::OutputFolder folder(study);
  const auto found = experiment::RunExperiment("gallery", plan, make, {}, study);
  if (!found) return rows;
  if (!study.out.empty()) {
    experiment::SaveReport(found->summary,
                           {.title = "Gallery: the guard at its default settings",
                            .program = "gallery",
                            .method_names = {{"alone", "Policy alone"}}},
                           study.out / "report.html");
  }
  const std::vector<experiment::UnitResult>& units = found->units;
  for (const std::string& task : study.tasks) {
    for (const std::string& policy : study.policies) {
      std::string learner = task + "/";
      learner += policy;
      for (std::size_t m = 0; m < plan.methods.size(); ++m) {
        Row row{.task = task, .policy = policy, .method = plan.methods[m]};
        for (const experiment::UnitResult& unit : units) {
          if (unit.unit.learner == learner) AddUnit(unit, m, row);
        }
        row.controls /= row.episodes;
        rows.push_back(std::move(row));
      }
    }
  }
  return rows;
}

std::vector<Recording> Record(const Study& study, const std::string& task,
                              const std::string& policy, int count) {
  Study one = study;
  one.tasks = {task};
  one.policies = {policy};
  const experiment::EvaluationPlan plan = MakePlan(one);
  Cache cache(one);
  const sim::GalleryTask& what = sim::FindGalleryTask(task);
  std::vector<Recording> recordings;
  for (const core::Trajectory& demonstration : cache.Get(what, 0)->demonstrations) {
    if (std::ssize(recordings) == count) break;
    recordings.push_back({"demonstrations", demonstration.outcome, demonstration.states});
  }
  const auto runner =
      MakeRunner(plan, {.demonstrations = one.demonstrations, .learner = plan.learners[0]}, cache);
  for (std::size_t method = 0; method < plan.methods.size(); ++method) {
    for (int i = 0; i < count; ++i) {
      // As experiment::Evaluate() has them.
      const std::uint64_t start =
          core::DeriveSeed(plan.seed, {0, 0, static_cast<std::uint64_t>(i), 0});
      const experiment::FilmedEpisode episode =
          runner->Watch(static_cast<int>(method), start, experiment::ControllerSeed(plan, 0, i));
      recordings.push_back({episode.method, episode.result.outcome, episode.states});
    }
  }
  return recordings;
}

void PrintTable(const std::vector<Row>& rows, bool causes, std::ostream& out) {
  out << core::Format("%-15s %-14s %-14s %-14s %-14s %-14s %5s %8s %6s %9s  %-14s %s\n", "task",
                      "policy", "method", "ok %", "failed %", "halted %", "saved", "saved-ok",
                      "harmed", "controls", "alarms in fail.", "false alarms");
  for (const Row& row : rows) {
    const bool monitor = row.method == Name(safety::Strategy::kMonitor);
    const auto share = [&](int count) { return 100.0 * count / row.episodes; };
    out << core::Format("%-15s %-14s %-14s %-14s %-14s %-14s %5.0f %8.0f %6.0f %9.1f  %-14s  %s\n",
                        row.task.c_str(), row.policy.c_str(), row.method.c_str(),
                        Percent(row.ok, row.episodes).c_str(),
                        Percent(row.failed, row.episodes).c_str(),
                        Percent(row.episodes - row.ok - row.failed, row.episodes).c_str(),
                        share(row.saved), share(row.saved_ok), share(row.harmed), row.controls,
                        monitor ? Percent(row.alarmed_failures, row.failed).c_str() : "",
                        monitor ? Percent(row.alarmed_successes, row.ok).c_str() : "");
    if (!causes) continue;
    for (const auto& [cause, count] : row.causes) out << "    " << count << " " << cause << '\n';
  }
}

void SaveCsv(const std::vector<Row>& rows, const std::filesystem::path& path) {
  std::ofstream out(path);
  out << "task,policy,method,episodes,ok,failed,halted,saved,saved_ok,harmed,alarmed_failures,"
         "alarmed_successes,controls\n";
  for (const Row& row : rows) {
    out << row.task << ',' << row.policy << ',' << row.method << ',' << row.episodes << ','
        << row.ok << ',' << row.failed << ',' << row.episodes - row.ok - row.failed << ','
        << row.saved << ',' << row.saved_ok << ',' << row.harmed << ',' << row.alarmed_failures
        << ',' << row.alarmed_successes << ',' << row.controls << '\n';
  }
  if (!out.flush()) throw std::runtime_error(path.string() + ": cannot be written");
}

}  // namespace dfr::study::gallery
