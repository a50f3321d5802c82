#include "dfr/study/policies.h"

#include <algorithm>
#include <bit>
#include <cstdint>
#include <limits>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "dfr/core/text/suggest.h"
#include "nearest_rows.h"

namespace dfr::study {
namespace {

// A policy with the dimensions of the learned policy.
class LikeAnother : public core::Policy {
 public:
  explicit LikeAnother(const core::Policy& learned) : learned_(&learned) {}
  [[nodiscard]] int state_dim() const noexcept override { return learned_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return learned_->control_dim(); }

 protected:
  [[nodiscard]] const core::Policy& learned() const noexcept { return *learned_; }

 private:
  const core::Policy* learned_;
};

class Zero final : public core::Policy {
 public:
  Zero(int state_dim, int control_dim) : state_dim_(state_dim), control_dim_(control_dim) {}
  [[nodiscard]] int state_dim() const noexcept override { return state_dim_; }
  [[nodiscard]] int control_dim() const noexcept override { return control_dim_; }
  void Control(int /*t*/, std::span<const double> /*x*/,
               std::span<double> u) const noexcept override {
    std::ranges::fill(u, 0.0);
  }

 private:
  int state_dim_;
  int control_dim_;
};

class Negated final : public LikeAnother {
 public:
  using LikeAnother::LikeAnother;
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override {
    learned().Control(t, x, u);
    for (double& entry : u) entry = -entry;
  }
};

class Haphazard final : public LikeAnother {
 public:
  Haphazard(const core::Policy& learned, const FittedTask& task)
      : LikeAnother(learned), task_(&task) {}
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override {
    std::uint64_t seed = static_cast<std::uint64_t>(t);
    for (const double entry : x) {
      seed = core::DeriveSeed(seed, {std::bit_cast<std::uint64_t>(entry)});
    }
    core::Random(seed).Direction(u);
    task_->Enlarge(u);
  }

 private:
  const FittedTask* task_;
};

// Tries the same directions on a copy of the plant at every control.
class Adversary final : public LikeAnother {
 public:
  enum class Aim { kConstraints, kOutOfSupport };

  Adversary(Aim aim, const core::Policy& learned, const FittedTask& task,
            const core::SimulatedPlant& plant)
      : LikeAnother(learned),
        aim_(aim),
        task_(&task),
        plant_(&plant),
        copy_(plant.Clone()),
        directions_(kDirections, plant.control_dim()),
        state_(static_cast<std::size_t>(plant.state_dim())),
        control_(static_cast<std::size_t>(plant.control_dim())) {
    constexpr std::uint64_t kSeed = 0x616476;
    core::Random random(kSeed);
    for (Eigen::Index i = 0; i < directions_.rows(); i += 2) {
      random.Direction(core::Row(directions_, i));
      task.Enlarge(core::Row(directions_, i));
      directions_.row(i + 1) = -directions_.row(i);
    }
  }

  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override {
    learned().Control(t, x, u);
    double worst = std::numeric_limits<double>::infinity();
    for (Eigen::Index i = 0; i < directions_.rows(); ++i) {
      core::AsVector(std::span(control_)) = directions_.row(i).transpose();
      const double found = aim_ == Aim::kConstraints ? StepsToCollision() : LevelAfter(t);
      if (found >= worst) continue;
      worst = found;
      std::ranges::copy(control_, u.begin());
    }
  }

 private:
  static constexpr int kDirections = 12;
  static constexpr int kHorizon = 12;

  // Returns the number of steps before a collision; infinity without a collision in kHorizon steps.
  double StepsToCollision() const noexcept {
    copy_->CopyStateFrom(*plant_);
    for (int i = 0; i < kHorizon; ++i) {
      if (copy_->Apply(control_) != core::PlantStatus::kOk) break;
      if (copy_->collided()) return i;
      if (copy_->completed()) break;
    }
    return std::numeric_limits<double>::infinity();
  }

  double LevelAfter(int t) const noexcept {
    copy_->CopyStateFrom(*plant_);
    if (copy_->Apply(control_) != core::PlantStatus::kOk) {
      return std::numeric_limits<double>::infinity();
    }
    copy_->Observe(state_);
    return task_->model().guided_support().LogDecision(t + 1, state_, {});
  }

  Aim aim_;
  const FittedTask* task_;
  const core::SimulatedPlant* plant_;
  // Scratch memory: this policy belongs to one thread.
  std::unique_ptr<core::SimulatedPlant> copy_;
  core::Matrix directions_;
  mutable std::vector<double> state_;
  mutable std::vector<double> control_;
};

}  // namespace

NearestNeighbourPolicy::NearestNeighbourPolicy(core::FeatureTransform features,
                                               std::span<const core::Trajectory> demonstrations)
    : features_(std::move(features)) {
  DFR_THROW_UNLESS(
      features_.num_features() <= kMostFeatures,
      "at most " << kMostFeatures << " features are supported, not " << features_.num_features());
  Eigen::Index rows = 0;
  Eigen::Index longest = 0;
  for (const core::Trajectory& d : demonstrations) {
    rows += d.controls.rows();
    longest = std::max(longest, d.controls.rows());
  }
  DFR_THROW_UNLESS(rows >= kNeighbours, "nearest neighbours need " << kNeighbours
                                                                   << " demonstrated controls, not "
                                                                   << rows);
  points_.resize(rows, features_.num_features());
  controls_.resize(rows, demonstrations[0].controls.cols());
  Eigen::Index row = 0;
  for (Eigen::Index t = 0; t < longest; ++t) {
    begin_.push_back(static_cast<int>(row));
    for (const core::Trajectory& d : demonstrations) {
      if (t >= d.controls.rows()) continue;
      features_.Apply(core::Row(d.states, t), core::Row(points_, row));
      controls_.row(row++) = d.controls.row(t);
    }
  }
  begin_.push_back(static_cast<int>(row));
}

void NearestNeighbourPolicy::Control(int t, std::span<const double> x,
                                     std::span<double> u) const noexcept {
  std::array<double, kMostFeatures> buffer;
  const std::span<double> z =
      std::span(buffer).first(static_cast<std::size_t>(features_.num_features()));
  features_.Apply(x, z);
  const int steps = static_cast<int>(begin_.size()) - 1;
  // Beyond the last time step, the last pairs still apply.
  const int here = std::clamp(t, 0, steps - 1);
  const int first = begin_[static_cast<std::size_t>(std::max(0, here - kWindow))];
  const int last = begin_[static_cast<std::size_t>(std::min(steps, here + kWindow + 1))];
  const auto nearest = internal::NearestRows<kNeighbours>(points_, first, last, z,
                                                          [](Eigen::Index) { return true; });
  std::ranges::fill(u, 0.0);
  int count = 0;
  for (const auto& [distance, row] : nearest) {
    if (row < 0) continue;
    core::AsVector(u) += controls_.row(row).transpose();
    ++count;
  }
  // A non-finite state has no neighbour.
  for (double& entry : u) {
    entry =
        count > 0 ? std::clamp(entry / count, -1.0, 1.0) : std::numeric_limits<double>::quiet_NaN();
  }
}

std::shared_ptr<const core::Policy> MakeUnlearned(
    std::string_view name, const core::FeatureTransform& features,
    std::span<const core::Trajectory> demonstrations) {
  if (name == "lwr") {
    return std::make_shared<imitation::LocallyWeightedPolicy>(features, demonstrations);
  }
  if (name == "lwr-cv") {
    imitation::LocallyWeightedOptions options;
    options.width = imitation::CrossValidatedWidth(features, demonstrations, options);
    return std::make_shared<imitation::LocallyWeightedPolicy>(features, demonstrations, options);
  }
  if (name == "knn") return std::make_shared<NearestNeighbourPolicy>(features, demonstrations);
  if (name != "none") return nullptr;
  DFR_THROW_UNLESS(!demonstrations.empty(), "there are no demonstrations");
  return std::make_shared<Zero>(features.state_dim(),
                                static_cast<int>(demonstrations[0].controls.cols()));
}

std::shared_ptr<const core::Policy> PolicyFactory::Make(std::string_view name,
                                                        const core::SimulatedPlant* plant) const {
  if (name == "lwr" || name == "lwr-cv" || name == "knn" || name == "none") {
    return *made_.Get(std::string(name), [&] {
      return MakeUnlearned(name, task_->model().features(), demonstrations_);
    });
  }
  if (name == "random") return std::make_shared<Haphazard>(*learned_, *task_);
  if (name == "negated") return std::make_shared<Negated>(*learned_);
  if (name == "ensemble") return Ensemble();
  if (name == "dart" || name == "dagger") {
    const auto learn = name == "dart" ? TrainDart : TrainDagger;
    return *made_.Get(std::string(name), [&] {
      return std::shared_ptr<const core::Policy>(
          learn(teaching_, *learned_, demonstrations_,
                teaching_.horizon > 0 ? teaching_.horizon : task_->horizon()));
    });
  }
  const bool constraints = name == "at-constraints";
  if (!constraints && name != "out-of-support") {
    throw core::UnknownName("policy", name, Join(kPolicies));
  }
  DFR_THROW_UNLESS(plant != nullptr, "the adversary '" << name << "' needs the driven plant");
  return std::make_shared<Adversary>(
      constraints ? Adversary::Aim::kConstraints : Adversary::Aim::kOutOfSupport, *learned_, *task_,
      *plant);
}

std::shared_ptr<const EnsemblePolicy> PolicyFactory::Ensemble() const {
  const auto policy = *made_.Get("ensemble", [&] {
    return std::shared_ptr<const core::Policy>(
        std::make_shared<EnsemblePolicy>(teaching_, demonstrations_));
  });
  return std::static_pointer_cast<const EnsemblePolicy>(policy);
}

}  // namespace dfr::study
