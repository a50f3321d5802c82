#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "apps/study/planar/methods.h"
#include "apps/study/task.h"
#include "dfr/core/trajectory.h"
#include "dfr/experiment/sequential_test.h"
#include "dfr/study/fitted_task.h"
#include "dfr/study/learned_model.h"
#include "dfr/study/placebo_runner.h"
#include "dfr/study/shared_cache.h"

namespace dfr::study {

/// Method name of the policy alone, in studies of controllers and guards. Tables call it "alone".
inline constexpr const char* kAlone = "baseline";

/// Kind of methods: controllers around a policy, guards around a policy, or planar::Methods.
enum class Kind { kControllers, kGuards, kPlane };

/// Options for guards on pictures, which run beside guards on states.
struct PictureOptions {
  std::string features = {};  ///< Features of "image", such as "points:image"; "": none.
  /// Disturbances of demonstrated pictures. Condition::nuisances disturb the pictures of a run.
  Nuisances shown = {.light = 0.2, .noise = 0.03};
};

/// Suffix of the method name of a guard that receives only pictures: "guard/pictures". Its policy
/// receives the state.
inline constexpr const char* kOnPictures = "/pictures";

/// Data shared by all methods of a task in one trial.
struct Prepared {
  std::unique_ptr<const LearnedModel> model = nullptr;     ///< For controllers.
  std::unique_ptr<const planar::Methods> plane = nullptr;  ///< For planar::Methods.
  std::vector<core::Trajectory> demonstrations = {};       ///< For guards.
  std::optional<FittedTask> guard = {};
  /// Guard model on pictures; may be null.
  std::shared_ptr<const safety::GuardModel> seeing = nullptr;
  std::uint64_t seed = 0;  ///< Seed of the policies.

  [[nodiscard]] const FittedTask& fit() const noexcept {
    return model != nullptr ? model->fit() : plane != nullptr ? plane->fit() : *guard;
  }
};
using PreparedCache = SharedCache<std::pair<std::string, int>, Prepared>;

/// @throws std::invalid_argument if the task does not support methods of this kind.
void CheckKind(const Task& task, Kind kind);

/// Fits the models that methods need: the task's models for controllers, or a guard with default
/// settings. `seed` is the seed of the study.
/// @pre CheckKind() accepts the task.
[[nodiscard]] Prepared Prepare(const Task& task, Kind kind, int demonstrations, std::uint64_t seed,
                               int trial, const planar::MethodOptions& plane = {},
                               const PictureOptions& pictures = {});

/// Task, variant and condition of a run.
struct Place {
  const Task* task;
  const Variant* variant;
  const Condition* condition;
};

class Guarded;
class Imitator;

/// Runs methods in one task under one condition. Only Kind::kPlane replaces start states outside
/// the support.
class Runner final : public PlaceboRunner {
 public:
  /// Each of `methods` is valid for ParseMethod(), one of PlaceboNames(), or, if `prepared` belongs
  /// to guards, "<guard's strategy>@<policy>[/pictures]". Borrows the parts of the place.
  Runner(const Place& place, std::shared_ptr<const Prepared> prepared,
         const std::vector<std::string>& methods);
  ~Runner() override;

  experiment::EpisodeResult Run(int method, std::uint64_t start_seed,
                                std::uint64_t controller_seed) override;
  /// Writes a video if the task has pictures and the file is not a page of paths.
  bool Film(const std::vector<int>& methods, std::uint64_t start_seed,
            std::uint64_t controller_seed, const std::filesystem::path& path) override;
  /// Returns the number of episodes with an alarm per monitor and outcome, named by AlarmsIn().
  std::map<std::string, double> Measures() override { return alarms_; }
  /// Returns the number of controls of each recovery, by method, in planar tasks only.
  std::map<std::string, std::vector<int>> Counts() override;

  /// Runs one episode and returns its credit.
  double Credit(int method, std::uint64_t start_seed, std::uint64_t controller_seed,
                const experiment::EpisodeCredit& credit);

 private:
  void Begin(int method, std::uint64_t start_seed) override;
  [[nodiscard]] bool Inside(std::span<const double> x) const override;
  [[nodiscard]] std::string CauseOf(const control::RolloutResult& result) const override;
  [[nodiscard]] bool CollidesAfterHalt() override;

  [[nodiscard]] std::unique_ptr<control::Controller> MakeController(const std::string& method);

  const Task* task_;
  Nuisances nuisances_;
  std::shared_ptr<const Prepared> prepared_;
  std::map<std::string, std::shared_ptr<Imitator>> imitators_;  // guards' policies
  std::vector<Guarded*> guarded_;                               // [method]
  int method_ = 0;                                              // method of the last episode
  std::map<std::string, double> alarms_;
};

/// Returns the name of the measure that counts a monitor's episodes with an alarm and this outcome.
[[nodiscard]] std::string AlarmsIn(core::Outcome outcome, const std::string& method);

}  // namespace dfr::study
