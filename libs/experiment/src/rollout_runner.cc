#include "dfr/experiment/rollout_runner.h"

#include <cstddef>
#include <utility>

namespace dfr::experiment {
namespace {

// Counts the controls of each recovery.
class RecoveryCounter final : public control::RolloutObserver {
 public:
  explicit RecoveryCounter(std::vector<int>& lengths) : lengths_(&lengths) {}
  void OnControl(const control::RolloutEvent& event) override {
    if (event.step.mode == control::Mode::kPolicy) return Flush();
    ++length_;
  }
  void OnEnd(const control::RolloutResult& /*result*/) override { Flush(); }

 private:
  void Flush() {
    if (length_ > 0) lengths_->push_back(length_);
    length_ = 0;
  }
  std::vector<int>* lengths_;
  int length_ = 0;
};

// Records the plant's true states and the source of each control.
class StateRecorder final : public control::RolloutObserver {
 public:
  StateRecorder(const core::Plant& plant, FilmedEpisode& episode)
      : plant_(&plant), episode_(&episode), state_(static_cast<std::size_t>(plant.state_dim())) {}
  void OnStart(std::span<const double> /*x*/) override { Record(); }
  void OnControl(const control::RolloutEvent& event) override {
    episode_->recovery.push_back(event.step.mode != control::Mode::kPolicy);
    Record();
  }
  void OnEnd(const control::RolloutResult& /*result*/) override {
    const auto width = static_cast<Eigen::Index>(state_.size());
    episode_->states =
        Eigen::Map<const core::Matrix>(states_.data(), std::ssize(states_) / width, width);
  }

 private:
  void Record() {
    plant_->Observe(state_);
    states_.insert(states_.end(), state_.begin(), state_.end());
  }
  const core::Plant* plant_;
  FilmedEpisode* episode_;
  std::vector<double> state_;
  std::vector<double> states_;  // concatenated
};

}  // namespace

RolloutRunner::RolloutRunner(std::unique_ptr<core::SimulatedPlant> plant,
                             const experiment::DisturbanceOptions& disturbance)
    : plant_(std::move(plant)), start_(static_cast<std::size_t>(plant_->state_dim())) {
  if (disturbance != experiment::DisturbanceOptions()) {
    disturbed_ = std::make_unique<experiment::DisturbedPlant>(plant_->Clone(), disturbance);
  }
}

void RolloutRunner::Add(std::string method, std::unique_ptr<control::Controller> controller) {
  names_.push_back(std::move(method));
  controllers_.push_back(std::move(controller));
  recovery_lengths_.emplace_back();
}

bool RolloutRunner::Accepts(std::uint64_t start_seed) {
  plant_->Reset(start_seed);
  plant_->Observe(start_);
  return Inside(start_);
}

control::RolloutResult RolloutRunner::RunObserved(int method, std::uint64_t start_seed,
                                                  std::uint64_t controller_seed,
                                                  control::RolloutObserver* observer,
                                                  int max_controls) {
  Begin(method, start_seed);
  return control::Rollout(
      driven(), *controllers_.at(static_cast<std::size_t>(method)),
      {.plant_seed = start_seed, .controller_seed = controller_seed, .max_controls = max_controls},
      observer, &workspace_);
}

bool RolloutRunner::Film(const std::vector<int>& methods, std::uint64_t start_seed,
                         std::uint64_t controller_seed, const std::filesystem::path& path) {
  std::vector<FilmedEpisode> episodes;
  episodes.reserve(methods.size());
  for (const int method : methods)
    episodes.push_back(RecordStates(method, start_seed, controller_seed));
  SaveFilm("Episodes from one start state", world().layout(), episodes, path);
  return true;
}

FilmedEpisode RolloutRunner::RecordStates(int method, std::uint64_t start_seed,
                                          std::uint64_t controller_seed) {
  FilmedEpisode episode{.method = MethodName(method), .result = {}, .states = {}, .recovery = {}};
  StateRecorder recorder(world(), episode);
  episode.result = ResultOf(RunObserved(method, start_seed, controller_seed, &recorder));
  return episode;
}

EpisodeResult RolloutRunner::Run(int method, std::uint64_t start_seed,
                                 std::uint64_t controller_seed) {
  RecoveryCounter counter(recovery_lengths_.at(static_cast<std::size_t>(method)));
  return ResultOf(RunObserved(method, start_seed, controller_seed, &counter));
}

EpisodeResult RolloutRunner::ResultOf(const control::RolloutResult& result) {
  EpisodeResult episode{.outcome = result.outcome,
                        .cause = CauseOf(result),
                        .controls = result.controls(),
                        .recovery_controls = result.recovery_controls(),
                        .changed_controls = result.changed_controls(),
                        .seconds = result.seconds(),
                        .change = result.change,
                        .sized_changes = result.sized_changes};
  if (result.outcome == core::Outcome::kHalted && CollidesAfterHalt()) {
    episode.outcome = core::Outcome::kCollided;
    episode.cause.insert(0, "after ");
  }
  return episode;
}

std::string RolloutRunner::CauseOf(const control::RolloutResult& result) const {
  switch (result.outcome) {
    case core::Outcome::kHalted:
      return control::Name(result.halt_cause);
    case core::Outcome::kCollided:
      return control::Name(result.last_mode);
    case core::Outcome::kCompleted:
      break;
  }
  return "";
}

}  // namespace dfr::experiment
