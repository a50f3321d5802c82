#include "apps/study/placebo.h"

#include <algorithm>
#include <utility>

namespace dfr::study {
namespace {

// Random stream, separate from others of a controller's seed.
constexpr std::uint64_t kStream = 0x706c616365626f;

}  // namespace

const std::vector<std::string>& PlaceboNames() {
  static const std::vector<std::string> names = {"placebo-corrections", "placebo-halts"};
  return names;
}

bool IsPlacebo(std::string_view method) noexcept {
  return std::ranges::count(PlaceboNames(), method) > 0;
}

Placebo::Placebo(std::unique_ptr<control::Controller> alone,
                 std::shared_ptr<const core::Policy> nominal, Distance distance)
    : alone_(std::move(alone)),
      nominal_(std::move(nominal)),
      distance_(std::move(distance)),
      control_(static_cast<std::size_t>(alone_->control_dim())) {}

void Placebo::DoReset(std::uint64_t seed) noexcept {
  alone_->Reset(seed);
  random_ = core::Random(core::DeriveSeed(seed, {kStream}));
}

control::Step Placebo::DoNext(std::span<const double> x, std::span<double> u) noexcept {
  control::Step step = alone_->Next(x, u);
  // Drawn for every control, so that the times do not depend on what the policy does.
  const bool fires = random_.Uniform() < rate_;
  if (step.mode == control::Mode::kHalt || !fires) return step;
  if (nominal_ == nullptr) return Halted(step, control::HaltCause::kStopRequested);
  nominal_->Control(step.t, x, control_);
  step.filtered = !std::ranges::equal(control_, u);
  step.change = distance_(control_, u);
  std::ranges::copy(control_, u.begin());
  return step;
}

}  // namespace dfr::study
