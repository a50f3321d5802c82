#include "dfr/study/placebo_runner.h"

#include <algorithm>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"
#include "dfr/study/policies.h"

namespace dfr::study {

void PlaceboRunner::AddAll(const std::vector<std::string>& methods, const Maker& make,
                           const FittedTask& task,
                           std::span<const core::Trajectory> demonstrations) {
  CheckPlacebos(methods);
  std::shared_ptr<const core::Policy> nominal;
  for (const std::string& method : methods) {
    Compared compared;
    std::unique_ptr<control::Controller> controller;
    if (IsPlacebo(method)) {
      const auto judged = std::ranges::find(methods, WithController(kJudged, method));
      compared.judged = static_cast<int>(judged - methods.begin());
      judged_.insert(compared.judged);
      const bool corrects = method.starts_with(PlaceboNames()[0]);
      if (corrects && nominal == nullptr) {
        nominal = MakeUnlearned("lwr", task.model().features(), demonstrations);
      }
      auto placebo = std::make_unique<Placebo>(
          make(WithController("baseline", method)), corrects ? nominal : nullptr,
          [&task](auto u, auto other) { return task.Distance(u, other); });
      compared.placebo = placebo.get();
      controller = std::move(placebo);
    } else {
      controller = make(method);
    }
    compared_.push_back(compared);
    Add(method, std::move(controller));
  }
}

experiment::EpisodeResult PlaceboRunner::Run(int method, std::uint64_t start_seed,
                                             std::uint64_t controller_seed) {
  const auto known = known_.find({method, start_seed, controller_seed});
  if (known != known_.end()) return known->second;
  const experiment::EpisodeResult result = RolloutRunner::Run(method, start_seed, controller_seed);
  if (judged_.contains(method)) known_[{method, start_seed, controller_seed}] = result;
  return result;
}

void PlaceboRunner::Begin(int method, std::uint64_t /*start_seed*/) {
  Compared& compared = compared_.at(static_cast<std::size_t>(method));
  if (compared.placebo != nullptr && !compared.has_rate) {
    compared.placebo->SetRate(RateOf(compared.judged));
    compared.has_rate = true;
  }
  running_ = method;
}

double PlaceboRunner::RateOf(int judged) {
  DFR_THROW_UNLESS(unit_.has_value(),
                   "a placebo runs only in an experiment, which determines its rate");
  std::int64_t changed = 0;
  std::int64_t controls = 0;
  for (int i = 0; i < plan_.episodes; ++i) {
    const std::uint64_t start = experiment::DrawStart(plan_, *unit_, i, *this).seed;
    const std::uint64_t controller = experiment::ControllerSeed(plan_, unit_->trial, i);
    const experiment::EpisodeResult result = Run(judged, start, controller);
    changed += result.changed_controls;
    controls += result.controls;
  }
  return controls > 0 ? static_cast<double>(changed) / static_cast<double>(controls) : 0.0;
}

std::string PlaceboRunner::CauseOf(const control::RolloutResult& result) const {
  const bool placebo = compared_.at(static_cast<std::size_t>(running_)).placebo != nullptr;
  if (placebo && result.outcome == core::Outcome::kCollided && result.last_step.filtered) {
    return "placebo";
  }
  return RolloutRunner::CauseOf(result);
}

}  // namespace dfr::study
