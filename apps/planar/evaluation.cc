#include "apps/planar/evaluation.h"

#include <algorithm>
#include <array>
#include <map>
#include <memory>
#include <mutex>
#include <utility>

#include "dfr/control/rollout.h"
#include "dfr/core/random.h"

namespace dfr::apps::planar {
namespace {

// How many controls each recovery took.
class RecoveryCounter final : public control::RolloutObserver {
 public:
  void OnControl(const control::RolloutEvent& event) override {
    const bool recovering = event.step.mode != control::Mode::kPolicy;
    if (recovering) {
      ++length_;
    } else {
      Flush();
    }
  }
  void OnEnd(const control::RolloutResult&) override { Flush(); }
  std::vector<int> lengths;

 private:
  void Flush() {
    if (length_ > 0) lengths.push_back(length_);
    length_ = 0;
  }
  int length_ = 0;
};

struct Shared {
  std::mutex mutex;
  // By trial and demonstrations, so that the order of threads does not matter.
  std::map<std::pair<int, int>, std::vector<std::vector<int>>> lengths;
};

class PlanarTrialRunner final : public experiment::TrialRunner {
 public:
  PlanarTrialRunner(const PlanarStudy& study, const experiment::EvaluationUnit& unit,
                    Shared& shared)
      : study_(study), unit_(unit), shared_(shared), task_(MakeTask(study.task)) {
    const std::uint64_t seed =
        core::DeriveSeed(study.plan.seed, {2, static_cast<std::uint64_t>(unit.trial)});
    methods_ = std::make_unique<Methods>(task_, Demonstrate(task_, unit.demonstrations, seed),
                                         study.methods);
    plant_ = std::make_unique<control::DisturbedPlant>(task_.plant->Clone(), study.disturbance);
    lengths_.resize(study.plan.methods.size());
  }
  ~PlanarTrialRunner() override {
    const std::lock_guard lock(shared_.mutex);
    shared_.lengths[{unit_.trial, unit_.demonstrations}] = std::move(lengths_);
  }
  PlanarTrialRunner(const PlanarTrialRunner&) = delete;
  PlanarTrialRunner& operator=(const PlanarTrialRunner&) = delete;

  bool Accepts(std::uint64_t start_seed) override {
    // As observed without noise, which is another for every episode.
    const auto plant = task_.plant->Clone();
    plant->Reset(start_seed);
    std::vector<double> x(static_cast<std::size_t>(plant->state_dim()));
    plant->Observe(x);
    return methods_->raw_support().Decision(0, x) >= 0.0 &&
           methods_->Level(SupportKind::kGuided, 0, x) >= 0.0 &&
           methods_->Level(SupportKind::kCertified, 0, x) >= 0.0;
  }

  experiment::EpisodeResult Run(int method, std::uint64_t start_seed,
                                std::uint64_t controller_seed) override {
    const auto m = static_cast<std::size_t>(method);
    const auto controller = methods_->Make(study_.plan.methods[m], *plant_);
    RecoveryCounter counter;
    const control::RolloutResult result =
        control::Rollout(*plant_, *controller,
                         {.plant_seed = start_seed, .controller_seed = controller_seed}, &counter);
    lengths_[m].insert(lengths_[m].end(), counter.lengths.begin(), counter.lengths.end());
    experiment::EpisodeResult episode;
    episode.outcome = result.outcome;
    if (result.outcome == core::Outcome::kHalted) {
      episode.cause = control::Name(result.halt_cause);
    } else if (result.outcome == core::Outcome::kCollided) {
      const bool filtered = result.last_step.filtered;
      episode.cause = filtered ? "filter" : control::Name(result.last_mode);
    }
    episode.controls = result.controls();
    episode.recovery_controls = result.recovery_controls();
    episode.seconds = result.seconds();
    return episode;
  }

 private:
  const PlanarStudy& study_;
  experiment::EvaluationUnit unit_;
  Shared& shared_;
  Task task_;
  std::unique_ptr<Methods> methods_;
  std::unique_ptr<control::DisturbedPlant> plant_;
  std::vector<std::vector<int>> lengths_;
};

}  // namespace

PlanarResult RunStudy(const PlanarStudy& study) {
  Shared shared;
  PlanarResult result;
  result.units = experiment::Evaluate(
      study.plan,
      [&](const experiment::EvaluationUnit& unit) -> std::unique_ptr<experiment::TrialRunner> {
        return std::make_unique<PlanarTrialRunner>(study, unit, shared);
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
