#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "apps/rollout_video.h"
#include "dfr/experiment/disturbed_plant.h"
#include "dfr/imitation/gaussian_policy.h"
#include "dfr/sim/pusher/pusher_plant.h"
#include "dfr/study/placebo_runner.h"
#include "model.h"
#include "supervisor/supervisor.h"

namespace dfr::apps::pusher {

/// Returns a support's overlap with the red regions, P(red | g >= 0). Displaces demonstrated states
/// at random (cylinder by at most 0.15 m, each joint by at most 0.1 rad) and keeps those with
/// g_t >= 0. The overlap is the fraction of kept states that collide. No recovery on g can avoid
/// these collisions.
[[nodiscard]] double SupportOverlap(const Model& model, const imitation::DemonstrationSet& set,
                                    sim::PusherPlant& plant, int samples, std::uint64_t seed);

/// Draws and encodes one picture, as PusherTrialRunner::Film() does.
/// @throws std::runtime_error naming the cause of a failure.
void CheckFilm(const std::filesystem::path& path, const sim::PusherOptions& plant_options);

/// One unit of the experiment: a model, and a plant to run it on.
class PusherTrialRunner final : public study::PlaceboRunner {
 public:
  PusherTrialRunner(Model model, const std::vector<safety::Method>& methods,
                    const sim::PusherOptions& plant_options,
                    std::map<std::string, double> measures);

  /// Returns the given measures, and the median "controls_per_recovery <method>" of each method
  /// with recoveries.
  [[nodiscard]] std::map<std::string, double> Measures() override;

  /// Writes pictures of 480 x 360 pixels.
  [[nodiscard]] bool Film(const std::vector<int>& methods, std::uint64_t start_seed,
                          std::uint64_t controller_seed,
                          const std::filesystem::path& path) override;

  [[nodiscard]] const std::vector<safety::Method>& methods() const noexcept { return methods_; }
  /// The plant that RunObserved() controls.
  [[nodiscard]] const sim::PusherPlant& plant() const noexcept {
    return static_cast<const sim::PusherPlant&>(undisturbed());
  }
  [[nodiscard]] Model& model() noexcept { return model_; }

 private:
  [[nodiscard]] bool Inside(std::span<const double> x) const override;

  Model model_;
  std::vector<safety::Method> methods_;
  std::map<std::string, double> measures_;
};

/// Runs some of the runner's methods from one start state and draws the rollouts.
[[nodiscard]] std::vector<RolloutVideo> RecordRollouts(PusherTrialRunner& runner,
                                                       const std::vector<std::string>& methods,
                                                       std::uint64_t start_seed,
                                                       std::uint64_t controller_seed, int width,
                                                       int height);

/// Options of the experiment that determine its results.
struct TrialRunnerOptions {
  std::vector<safety::Method> methods;
  ModelOptions model;  ///< The unit sets the learner and the seed.
  sim::PusherOptions plant;
  int most_demonstrations = 120;
  std::uint64_t seed = 1;
};

/// Makes runners. Collects the demonstrations of a trial once, for all its units. Several threads
/// may use one factory.
class TrialRunnerFactory {
 public:
  /// Trial t demonstrates with supervisors[t % supervisors.size()].
  TrialRunnerFactory(const std::vector<imitation::GaussianPolicy>& supervisors,
                     TrialRunnerOptions options, int trials);

  [[nodiscard]] std::unique_ptr<PusherTrialRunner> Make(const experiment::EvaluationUnit& unit);

 private:
  struct Trial {
    std::once_flag collected;
    imitation::DemonstrationSet set;
    DemonstrationCounts counts;
  };
  std::vector<imitation::GaussianPolicy> supervisors_;
  TrialRunnerOptions options_;
  std::vector<std::unique_ptr<Trial>> trials_;
};

}  // namespace dfr::apps::pusher
