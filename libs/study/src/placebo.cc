#include "dfr/study/placebo.h"

#include <algorithm>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/study/controller_factory.h"

namespace dfr::study {
namespace {

// Random stream, separate from other streams of a controller's seed.
constexpr std::uint64_t kStream = 0x706c616365626f;

}  // namespace

const std::vector<std::string>& PlaceboNames() {
  static const std::vector<std::string> names = {"placebo-corrections", "placebo-halts"};
  return names;
}

bool IsComparison(std::string_view method) noexcept {
  return IsPlacebo(method) || IsOracle(method);
}

bool IsPlacebo(std::string_view method) noexcept {
  return std::ranges::count(PlaceboNames(), method.substr(0, method.find('@'))) > 0;
}

std::string WithController(std::string_view controller, std::string_view method) {
  const std::size_t at = std::min(method.find('@'), method.size());
  return std::string(controller).append(method.substr(at));
}

safety::Method ParseCompared(std::string_view method, std::span<const std::string_view> others) {
  if (!IsPlacebo(method)) return ParseMethod(method, others);
  safety::Method parsed = ParseMethod(WithController("baseline", method), others);
  parsed.name = method;
  return parsed;
}

void CheckPlacebos(std::span<const std::string> methods) {
  for (const std::string& method : methods) {
    if (!IsPlacebo(method)) continue;
    const std::string judged = WithController(kJudged, method);
    DFR_THROW_UNLESS(std::ranges::count(methods, judged) > 0,
                     "the method '" << method << "' intervenes as often as the method '" << judged
                                    << "' does: add '" << judged << "' to the methods");
  }
}

Placebo::Placebo(std::unique_ptr<control::Controller> alone,
                 std::shared_ptr<const core::Policy> nominal, Distance distance)
    : alone_(std::move(alone)),
      learner_(dynamic_cast<LearnsOnline*>(alone_.get())),
      nominal_(std::move(nominal)),
      distance_(std::move(distance)),
      control_(static_cast<std::size_t>(alone_->control_dim())) {}

void Placebo::DoReset(std::uint64_t seed) noexcept {
  alone_->Reset(seed);
  random_ = core::Random(core::DeriveSeed(seed, {kStream}));
}

control::Step Placebo::DoNext(std::span<const double> x, std::span<double> u) noexcept {
  control::Step step = alone_->Next(x, u);
  // Draws for every control, which makes the times of interruptions independent of the policy.
  const bool fires = random_.Uniform() < rate_;
  if (step.mode == control::Mode::kHalt || !fires) return step;
  if (nominal_ == nullptr) return Halted(step, control::HaltCause::kStopRequested);
  nominal_->Control(step.t, x, control_);
  step.filtered = !std::ranges::equal(control_, u);
  step.change = distance_(control_, u);
  std::ranges::copy(control_, u.begin());
  if (learner_ != nullptr) learner_->Applied(u);
  return step;
}

}  // namespace dfr::study
