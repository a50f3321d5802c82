#include "apps/planar/evaluation.h"

#include <algorithm>
#include <cstddef>
#include <map>
#include <memory>
#include <utility>

#include "apps/planar/picture.h"
#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "dfr/experiment/ledger.h"
#include "dfr/experiment/report.h"
#include "dfr/experiment/rollout_runner.h"

namespace dfr::study::planar {
namespace {

class PlanarTrialRunner final : public experiment::RolloutRunner {
 public:
  PlanarTrialRunner(const PlanarStudy& study, const experiment::EvaluationPlan& plan, int trial,
                    int demonstrations, const Task& task)
      : RolloutRunner(task.plant->Clone(), study.disturbance),
        task_(task),
        names_(plan.methods),
        methods_(task,
                 Demonstrate(task, demonstrations,
                             core::DeriveSeed(plan.seed, {2, static_cast<std::uint64_t>(trial)})),
                 study.methods,
                 core::DeriveSeed(plan.seed, {3, static_cast<std::uint64_t>(trial)})) {
    for (const std::string& method : names_) {
      Add(method, methods_.Make(method, driven()));
    }
  }

  std::map<std::string, std::vector<int>> Counts() override {
    std::map<std::string, std::vector<int>> counts;
    for (std::size_t m = 0; m < names_.size(); ++m) counts[names_[m]] = recovery_lengths()[m];
    return counts;
  }

  bool Film(const std::vector<int>& methods, std::uint64_t start_seed,
            std::uint64_t controller_seed, const std::filesystem::path& path) override {
    std::vector<Episode> episodes(methods.size());
    for (std::size_t i = 0; i < methods.size(); ++i) {
      episodes[i].method = MethodName(methods[i]);
      EpisodeRecorder recorder(episodes[i]);
      Watch(methods[i], start_seed, controller_seed, &recorder);
    }
    Painter(task_, methods_).WriteVideo(episodes, path);
    return true;
  }

 private:
  bool Inside(std::span<const double> x) const override {
    return methods_.raw_support().Decision(0, x) >= 0.0 &&
           methods_.Level(SupportKind::kGuided, 0, x) >= 0.0 &&
           methods_.Level(SupportKind::kCertified, 0, x) >= 0.0;
  }

  std::string CauseOf(const control::RolloutResult& result) const override {
    const bool filtered = result.last_step.filtered;
    if (result.outcome == core::Outcome::kCollided && filtered) return "filter";
    return RolloutRunner::CauseOf(result);
  }

  const Task& task_;
  std::vector<std::string> names_;
  Methods methods_;
};

}  // namespace

PlanarResult RunStudy(const PlanarStudy& study) {
  std::vector<PlanarResult> results = RunVariants("planar", {{study.plan.learners.front(), study}});
  DFR_THROW_UNLESS(!results.empty(), "a shard has no results of its own");
  return std::move(results.front());
}

std::vector<PlanarResult> RunVariants(const std::string& name,
                                      const std::vector<Variant>& variants) {
  const PlanarStudy& first = variants.front().study;
  experiment::EvaluationPlan plan = first.plan;
  plan.learners.clear();
  std::vector<Task> tasks;
  for (const Variant& variant : variants) {
    DFR_THROW_UNLESS(variant.study.plan.demonstrations.size() == plan.demonstrations.size(),
                     "'" << variant.name << "' has " << variant.study.plan.demonstrations.size()
                         << " data points, not " << plan.demonstrations.size()
                         << "; give one number of demonstrations");
    plan.learners.push_back(variant.name);
    tasks.push_back(MakeTask(variant.study.task));
  }
  const auto make =
      [&](const experiment::EvaluationUnit& unit) -> std::unique_ptr<experiment::TrialRunner> {
    const auto v = static_cast<std::size_t>(std::ranges::find(plan.learners, unit.learner) -
                                            plan.learners.begin());
    const auto point = static_cast<std::size_t>(
        std::ranges::find(plan.demonstrations, unit.demonstrations) - plan.demonstrations.begin());
    const PlanarStudy& study = variants[v].study;
    return std::make_unique<PlanarTrialRunner>(study, plan, unit.trial,
                                               study.plan.demonstrations[point], tasks[v]);
  };
  using experiment::Exactly;
  const MethodOptions& methods = first.methods;
  const experiment::OutputFolder folder(first.run);
  const std::map<std::string, std::string> settings = {
      {"task", first.task},
      {"gamma", Exactly(methods.gamma)},
      {"raw gamma", Exactly(methods.raw_gamma)},
      {"certified gamma", Exactly(methods.certified_gamma)},
      {"certified level", Exactly(methods.certified_level)},
      {"factor", Exactly(methods.gain_factor)}};
  const auto found = experiment::RunExperiment(name, plan, make, settings, first.run);
  std::vector<PlanarResult> results;
  if (!found) return results;
  if (!first.run.out.empty()) {
    experiment::SaveReport(found->summary,
                           {.title = "Planar tasks: " + first.task,
                            .program = "planar",
                            .settings = {settings.begin(), settings.end()}},
                           first.run.out / "report.html");
  }
  for (const Variant& variant : variants) {
    PlanarResult& result = results.emplace_back();
    result.recovery_lengths.resize(plan.methods.size());
    for (const experiment::UnitResult& unit : found->units) {
      if (unit.unit.learner != variant.name) continue;
      result.units.push_back(unit);
      for (std::size_t m = 0; m < plan.methods.size(); ++m) {
        const std::vector<int>& lengths = unit.counts.at(plan.methods[m]);
        auto& all = result.recovery_lengths[m];
        all.insert(all.end(), lengths.begin(), lengths.end());
      }
    }
  }
  return results;
}

}  // namespace dfr::study::planar
