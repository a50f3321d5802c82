#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/control/rollout.h"
#include "dfr/core/plant.h"
#include "dfr/experiment/disturbed_plant.h"
#include "dfr/experiment/film.h"
#include "dfr/experiment/paired_evaluation.h"

namespace dfr::experiment {

/// A unit whose methods are controllers of one plant, rolled out from the same start states.
class RolloutRunner : public TrialRunner {
 public:
  /// Accepts the start states, observed without disturbance, for which Inside() returns true.
  [[nodiscard]] bool Accepts(std::uint64_t start_seed) override;
  /// Runs one rollout. The result's cause is CauseOf() of the rollout.
  [[nodiscard]] EpisodeResult Run(int method, std::uint64_t start_seed,
                                  std::uint64_t controller_seed) override;
  /// Writes a page of the undisturbed plant's states with SaveFilm(). Derived classes that can draw
  /// their plant may override this function.
  [[nodiscard]] bool Film(const std::vector<int>& methods, std::uint64_t start_seed,
                          std::uint64_t controller_seed,
                          const std::filesystem::path& path) override;

  /// Same as Run(), but also returns the undisturbed plant's states.
  [[nodiscard]] FilmedEpisode RecordStates(int method, std::uint64_t start_seed,
                                           std::uint64_t controller_seed);

  /// Same as Run(), with an observer that may draw the plant, and at most `max_controls` controls.
  control::RolloutResult RunObserved(int method, std::uint64_t start_seed,
                                     std::uint64_t controller_seed,
                                     control::RolloutObserver* observer,
                                     int max_controls = 1'000'000);

  /// Entry [method] lists the number of controls of each recovery in Run().
  [[nodiscard]] const std::vector<std::vector<int>>& recovery_lengths() const noexcept {
    return recovery_lengths_;
  }

 protected:
  /// @param disturbance  disturbance of the plant that methods drive. If it is not zero, they drive
  ///   a disturbed copy of `plant`.
  explicit RolloutRunner(std::unique_ptr<core::SimulatedPlant> plant,
                         const experiment::DisturbanceOptions& disturbance = {});
  /// Appends the controller of the plan's next method, named `method`.
  void Add(std::string method, std::unique_ptr<control::Controller> controller);
  [[nodiscard]] const std::string& MethodName(int method) const {
    return names_.at(static_cast<std::size_t>(method));
  }
  /// Returns the plant that methods drive.
  [[nodiscard]] core::SimulatedPlant& driven() noexcept {
    return disturbed_ != nullptr ? static_cast<core::SimulatedPlant&>(*disturbed_) : *plant_;
  }
  /// Returns the undisturbed plant inside driven().
  [[nodiscard]] core::SimulatedPlant& world() noexcept {
    return disturbed_ != nullptr ? disturbed_->undisturbed() : *plant_;
  }
  [[nodiscard]] const core::SimulatedPlant& undisturbed() const noexcept { return *plant_; }

  /// Called before each episode of a method.
  virtual void Begin(int /*method*/, std::uint64_t /*start_seed*/) {}
  /// Returns true if a start state is inside the support.
  [[nodiscard]] virtual bool Inside(std::span<const double> x) const = 0;
  /// Returns EpisodeResult::cause: the cause of the halt, or the mode of the control that collided.
  [[nodiscard]] virtual std::string CauseOf(const control::RolloutResult& result) const;
  /// Returns true if the world, without further control, collides after a halt. The episode then
  /// counts as collided, with the cause "after <cause of the halt>".
  [[nodiscard]] virtual bool CollidesAfterHalt() { return false; }

  /// Returns the result of a rollout that has just ended.
  [[nodiscard]] EpisodeResult ResultOf(const control::RolloutResult& result);

 private:
  std::unique_ptr<core::SimulatedPlant> plant_;
  std::unique_ptr<experiment::DisturbedPlant> disturbed_;  // nullptr: methods drive plant_ itself
  std::vector<std::string> names_;
  std::vector<std::unique_ptr<control::Controller>> controllers_;
  std::vector<std::vector<int>> recovery_lengths_;
  control::RolloutWorkspace workspace_;
  std::vector<double> start_;
};

}  // namespace dfr::experiment
