#include "apps/planar/evaluation.h"

#include <map>
#include <memory>
#include <mutex>
#include <utility>

#include "dfr/core/random.h"
#include "dfr/experiment/rollout_runner.h"

namespace dfr::apps::planar {
namespace {

struct Shared {
  std::mutex mutex;
  // By trial and demonstrations, so that the order of threads does not matter.
  std::map<std::pair<int, int>, std::vector<std::vector<int>>> lengths;
};

class PlanarTrialRunner final : public experiment::RolloutRunner {
 public:
  PlanarTrialRunner(const PlanarStudy& study, const experiment::EvaluationUnit& unit,
                    Shared& shared, const Task& task)
      : RolloutRunner(task.plant->Clone(), study.disturbance),
        unit_(unit),
        shared_(shared),
        methods_(task,
                 Demonstrate(task, unit.demonstrations,
                             core::DeriveSeed(study.plan.seed,
                                              {2, static_cast<std::uint64_t>(unit.trial)})),
                 study.methods,
                 core::DeriveSeed(study.plan.seed, {3, static_cast<std::uint64_t>(unit.trial)})) {
    for (const std::string& method : study.plan.methods) Add(methods_.Make(method, driven()));
  }
  ~PlanarTrialRunner() override {
    const std::lock_guard lock(shared_.mutex);
    shared_.lengths[{unit_.trial, unit_.demonstrations}] = recovery_lengths();
  }
  PlanarTrialRunner(const PlanarTrialRunner&) = delete;
  PlanarTrialRunner& operator=(const PlanarTrialRunner&) = delete;

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

  experiment::EvaluationUnit unit_;
  Shared& shared_;
  Methods methods_;
};

}  // namespace

PlanarResult RunStudy(const PlanarStudy& study) {
  const Task task = MakeTask(study.task);
  Shared shared;
  PlanarResult result;
  result.units = experiment::Evaluate(
      study.plan,
      [&](const experiment::EvaluationUnit& unit) -> std::unique_ptr<experiment::TrialRunner> {
        return std::make_unique<PlanarTrialRunner>(study, unit, shared, task);
      },
      {.threads = study.threads});
  result.recovery_lengths.resize(study.plan.methods.size());
  for (const auto& [unit, lengths] : shared.lengths) {
    for (std::size_t m = 0; m < lengths.size(); ++m) {
      auto& all = result.recovery_lengths[m];
      all.insert(all.end(), lengths[m].begin(), lengths[m].end());
    }
  }
  return result;
}

}  // namespace dfr::apps::planar
