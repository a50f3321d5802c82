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
  /// Accepts the start states of which Inside() says so, as observed without disturbance.
  [[nodiscard]] bool Accepts(std::uint64_t start_seed) override;
  /// One rollout, with CauseOf() as its cause.
  [[nodiscard]] EpisodeResult Run(int method, std::uint64_t start_seed,
                                  std::uint64_t controller_seed) override;
  /// A page of the undisturbed plant's states, as SaveFilm() writes it; derived classes that can
  /// draw their plant may do better.
  [[nodiscard]] bool Film(const std::vector<int>& methods, std::uint64_t start_seed,
                          std::uint64_t controller_seed,
                          const std::filesystem::path& path) override;

  /// Run(), with the undisturbed plant's states.
  [[nodiscard]] FilmedEpisode RecordStates(int method, std::uint64_t start_seed,
                                           std::uint64_t controller_seed);

  /// Run() with an observer, who may draw the plant; ends after `max_controls`.
  control::RolloutResult Watch(int method, std::uint64_t start_seed, std::uint64_t controller_seed,
                               control::RolloutObserver* observer, int max_controls = 1'000'000);

  /// [method]: how many controls each recovery of Run() took.
  [[nodiscard]] const std::vector<std::vector<int>>& recovery_lengths() const noexcept {
    return recovery_lengths_;
  }

 protected:
  /// @param disturbance  of the plant that methods drive: where it is not zero, they drive a
  ///   disturbed copy of `plant`.
  explicit RolloutRunner(std::unique_ptr<core::SimulatedPlant> plant,
                         const experiment::DisturbanceOptions& disturbance = {});
  /// Appends the controller of the plan's next method, which has that name.
  void Add(std::string method, std::unique_ptr<control::Controller> controller);
  [[nodiscard]] const std::string& MethodName(int method) const {
    return names_.at(static_cast<std::size_t>(method));
  }
  /// What methods drive.
  [[nodiscard]] core::SimulatedPlant& driven() noexcept {
    return disturbed_ != nullptr ? static_cast<core::SimulatedPlant&>(*disturbed_) : *plant_;
  }
  /// The plant inside of what methods drive.
  [[nodiscard]] core::SimulatedPlant& world() noexcept {
    return disturbed_ != nullptr ? disturbed_->undisturbed() : *plant_;
  }
  [[nodiscard]] const core::SimulatedPlant& undisturbed() const noexcept { return *plant_; }

  /// Called before each episode of a method.
  virtual void Begin(int /*method*/, std::uint64_t /*start_seed*/) {}
  /// Whether a start state is inside the support.
  [[nodiscard]] virtual bool Inside(std::span<const double> x) const = 0;
  /// EpisodeResult::cause: why it halted, or the mode of the control that collided.
  [[nodiscard]] virtual std::string CauseOf(const control::RolloutResult& result) const;
  /// Whether the world, which the controller has left to itself, collides after a halt: the episode
  /// has collided then, with the cause "after <why it halted>".
  [[nodiscard]] virtual bool CollidesAfterHalt() { return false; }

  /// The episode of a rollout that has just ended.
  [[nodiscard]] EpisodeResult ResultOf(const control::RolloutResult& result);

 private:
  std::unique_ptr<core::SimulatedPlant> plant_;
  std::unique_ptr<experiment::DisturbedPlant> disturbed_;  // null: plant_ itself is driven
  std::vector<std::string> names_;
  std::vector<std::unique_ptr<control::Controller>> controllers_;
  std::vector<std::vector<int>> recovery_lengths_;
  control::RolloutWorkspace workspace_;
  std::vector<double> start_;
};

}  // namespace dfr::experiment
