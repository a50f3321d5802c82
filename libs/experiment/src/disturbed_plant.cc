#include "dfr/experiment/disturbed_plant.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "dfr/core/contract.h"

namespace dfr::experiment {

DisturbedPlant::DisturbedPlant(std::unique_ptr<core::SimulatedPlant> plant,
                               const DisturbanceOptions& options)
    : plant_(std::move(plant)), options_(options) {
  DFR_THROW_UNLESS(plant_ != nullptr, "there is no plant to disturb");
  for (const double value :
       {options.rotation_sd, options.scale_sd, options.bias, options.actuator_noise,
        options.observation_noise, static_cast<double>(options.control_delay), options.dropped,
        static_cast<double>(options.observation_delay), options.missing}) {
    DFR_THROW_UNLESS(value >= 0.0 && std::isfinite(value),
                     "disturbances must not be negative or infinite: " << value);
  }
  DFR_THROW_UNLESS(
      options.dropped <= 1.0 && options.missing <= 1.0,
      "probabilities must not exceed 1: " << options.dropped << ", " << options.missing);
  const auto m = static_cast<std::size_t>(plant_->control_dim());
  const auto n = static_cast<std::size_t>(plant_->state_dim());
  given_.resize(m * static_cast<std::size_t>(options.control_delay));
  happened_.resize(n * static_cast<std::size_t>(options.observation_delay));
  seen_.resize(n);
  for (auto* v : {&first_, &second_, &bias_, &asked_, &control_}) v->resize(m);
  noise_.resize(n);
  plant_->Observe(seen_);
}

void DisturbedPlant::Reset(std::uint64_t seed) {
  plant_->Reset(seed);
  // Draws from a separate stream: the start state stays equal to the undisturbed plant's.
  constexpr std::uint64_t kStream = 0x646973;
  random_ = core::Random(core::DeriveSeed(seed, {kStream}));
  const double angle = options_.rotation_sd * random_.Normal();
  cosine_ = std::cos(angle);
  sine_ = std::sin(angle);
  scale_ = std::exp(options_.scale_sd * random_.Normal());
  random_.Direction(bias_);
  for (double& b : bias_) b *= options_.bias;
  if (first_.size() == 2) {
    first_ = {1.0, 0.0};
    second_ = {0.0, 1.0};
  } else if (first_.size() > 2) {
    random_.Direction(first_);
    double norm = 0.0;
    do {
      random_.Direction(second_);
      const double along = std::inner_product(first_.begin(), first_.end(), second_.begin(), 0.0);
      for (std::size_t i = 0; i < second_.size(); ++i) second_[i] -= along * first_[i];
      norm = std::sqrt(std::inner_product(second_.begin(), second_.end(), second_.begin(), 0.0));
    } while (norm < 0.1);
    for (double& s : second_) s /= norm;
  }
  DrawNoise();
  std::ranges::fill(given_, 0.0);
  plant_->Observe(seen_);
  for (std::size_t i = 0; i < happened_.size(); ++i) happened_[i] = seen_[i % seen_.size()];
}

// Called after every control: observes the current state, or an earlier one.
void DisturbedPlant::See() noexcept {
  const bool lost = options_.missing > 0.0 && random_.Uniform() < options_.missing;
  if (happened_.empty()) {
    if (!lost) plant_->Observe(seen_);
    return;
  }
  if (!lost) std::copy_n(happened_.begin(), seen_.size(), seen_.begin());
  std::rotate(happened_.begin(), happened_.begin() + std::ssize(seen_), happened_.end());
  plant_->Observe(std::span(happened_).last(seen_.size()));
}

void DisturbedPlant::DrawNoise() noexcept {
  for (double& n : noise_) {
    n = options_.observation_noise > 0.0 ? options_.observation_noise * random_.Normal() : 0.0;
  }
}

core::PlantStatus DisturbedPlant::Apply(std::span<const double> control) noexcept {
  if (control.size() != control_.size()) return core::PlantStatus::kRefused;
  std::ranges::copy(control, asked_.begin());
  if (options_.dropped > 0.0 && random_.Uniform() < options_.dropped) {
    std::ranges::fill(asked_, 0.0);
  }
  if (!given_.empty()) {
    std::ranges::swap_ranges(asked_, std::span(given_).first(asked_.size()));
    std::rotate(given_.begin(), given_.begin() + std::ssize(asked_), given_.end());
  }
  // A single entry cannot be rotated.
  double a = 0.0;
  double b = 0.0;
  if (control.size() >= 2) {
    a = std::inner_product(first_.begin(), first_.end(), asked_.begin(), 0.0);
    b = std::inner_product(second_.begin(), second_.end(), asked_.begin(), 0.0);
  }
  const double da = cosine_ * a - sine_ * b - a;
  const double db = sine_ * a + cosine_ * b - b;
  for (std::size_t i = 0; i < control_.size(); ++i) {
    control_[i] = scale_ * (asked_[i] + da * first_[i] + db * second_[i]) + bias_[i];
    if (options_.actuator_noise > 0.0) control_[i] += options_.actuator_noise * random_.Normal();
  }
  const core::PlantStatus status = plant_->Apply(control_);
  DrawNoise();
  See();
  return status;
}

void DisturbedPlant::Observe(std::span<double> state) const noexcept {
  std::ranges::copy(seen_, state.begin());
  for (std::size_t i = 0; i < noise_.size(); ++i) state[i] += noise_[i];
}

std::unique_ptr<core::SimulatedPlant> DisturbedPlant::Clone() const {
  auto copy = std::make_unique<DisturbedPlant>(plant_->Clone(), options_);
  copy->CopyStateFrom(*this);
  return copy;
}

void DisturbedPlant::CopyStateFrom(const core::SimulatedPlant& other) noexcept {
  const auto& from = static_cast<const DisturbedPlant&>(other);
  plant_->CopyStateFrom(*from.plant_);
  random_ = from.random_;
  cosine_ = from.cosine_;
  sine_ = from.sine_;
  scale_ = from.scale_;
  std::copy(from.first_.begin(), from.first_.end(), first_.begin());
  std::copy(from.second_.begin(), from.second_.end(), second_.begin());
  std::copy(from.bias_.begin(), from.bias_.end(), bias_.begin());
  std::copy(from.noise_.begin(), from.noise_.end(), noise_.begin());
  std::ranges::copy(from.given_, given_.begin());
  std::ranges::copy(from.happened_, happened_.begin());
  std::ranges::copy(from.seen_, seen_.begin());
}

}  // namespace dfr::experiment
