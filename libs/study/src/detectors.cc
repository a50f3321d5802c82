#include "dfr/study/detectors.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "dfr/control/phase_tracker.h"
#include "dfr/core/contract.h"
#include "dfr/core/numerics/quantile.h"
#include "dfr/core/random.h"
#include "dfr/imitation/fit_mlp.h"
#include "dfr/imitation/mlp.h"
#include "dfr/kernel/model_selection.h"
#include "dfr/study/baselines.h"
#include "dfr/study/policies.h"
#include "dfr/study/supports.h"

namespace dfr::study {
namespace {

constexpr std::uint64_t kTargetStream = 1;
constexpr std::uint64_t kPredictorStream = 2;
constexpr double kUnlimited = 1e9;

// Scores a state by -l of a support at the best-fitting time step near the current one.
class SupportDetector final : public Detector {
 public:
  SupportDetector(std::string_view name, const FittedTask& fit,
                  const imitation::DemonstrationSet& set)
      : support_(name, fit, set.layout, set.trajectories) {}
  [[nodiscard]] std::vector<double> Scores(const core::Matrix& states) const override {
    const core::Matrix z = support_.view().features().Apply(states);
    control::PhaseTracker tracker(support_.view().support());
    std::vector<double> scores;
    scores.reserve(static_cast<std::size_t>(z.rows()));
    for (Eigen::Index t = 0; t < z.rows(); ++t) scores.push_back(-tracker.Follow(core::Row(z, t)));
    return scores;
  }

 private:
  SupportModel support_;
};

class Distillation final : public Detector {
 public:
  Distillation(const core::FeatureTransform& features, const imitation::DemonstrationSet& set,
               std::uint64_t seed)
      : features_(&features),
        target_(Target(features.num_features(), seed)),
        predictor_(Fit(set.trajectories, seed)) {}
  [[nodiscard]] std::vector<double> Scores(const core::Matrix& states) const override {
    const core::Matrix z = features_->Apply(states);
    const core::Matrix targets = TargetsOf(z);
    Eigen::VectorXd guess(kOutputs);
    std::vector<double> scores;
    scores.reserve(static_cast<std::size_t>(z.rows()));
    for (Eigen::Index t = 0; t < z.rows(); ++t) {
      predictor_.Control(0, core::Row(z, t), core::AsSpan(guess));
      scores.push_back((guess.transpose() - targets.row(t)).squaredNorm());
    }
    return scores;
  }

 private:
  static constexpr int kOutputs = 16;

  static imitation::Mlp Target(int features, std::uint64_t seed) {
    core::Random random(core::DeriveSeed(seed, {kTargetStream}));
    return imitation::Mlp({features, 64, kOutputs}, random);
  }
  [[nodiscard]] core::Matrix TargetsOf(const core::Matrix& z) const {
    imitation::Mlp::Workspace workspace;
    return target_.Forward(z, workspace);
  }
  [[nodiscard]] imitation::MlpPolicy Fit(std::span<const core::Trajectory> demonstrations,
                                         std::uint64_t seed) const {
    Eigen::Index rows = 0;
    for (const core::Trajectory& d : demonstrations) rows += d.states.rows();
    core::Matrix z(rows, features_->num_features());
    rows = 0;
    for (const core::Trajectory& d : demonstrations) {
      z.middleRows(rows, d.states.rows()) = features_->Apply(d.states);
      rows += d.states.rows();
    }
    core::StateLayout layout;
    layout.Add("z", features_->num_features());
    return imitation::FitMlp(layout, z, TargetsOf(z),
                             {.hidden = {64},
                              .control_limit = kUnlimited,
                              .skip_zero_controls = false,
                              .epochs = 30,
                              .seed = core::DeriveSeed(seed, {kPredictorStream})});
  }

  const core::FeatureTransform* features_;
  imitation::Mlp target_;
  imitation::MlpPolicy predictor_;
};

class Disagreement final : public Detector {
 public:
  Disagreement(const FittedTask& fit, const imitation::DemonstrationSet& set, std::uint64_t seed)
      : ensemble_(Teaching(fit, set, seed), fit.Measured(set.trajectories)) {}
  [[nodiscard]] std::vector<double> Scores(const core::Matrix& states) const override {
    std::vector<double> u(static_cast<std::size_t>(ensemble_.control_dim()));
    std::vector<double> scores;
    scores.reserve(static_cast<std::size_t>(states.rows()));
    for (Eigen::Index t = 0; t < states.rows(); ++t) {
      scores.push_back(ensemble_.Mean(static_cast<int>(t), core::Row(states, t), u));
    }
    return scores;
  }

 private:
  static Expert Teaching(const FittedTask& fit, const imitation::DemonstrationSet& set,
                         std::uint64_t seed) {
    const std::vector<core::Trajectory> one =
        fit.Measured(std::span(set.trajectories).first(set.trajectories.empty() ? 0 : 1));
    DFR_THROW_UNLESS(!one.empty(), "there are no demonstrations");
    const imitation::DemonstrationSet like{.layout = set.layout,
                                           .control_dim = static_cast<int>(one[0].controls.cols()),
                                           .environment = set.environment,
                                           .trajectories = {},
                                           .note = {}};
    return TeachMlp(like, {.control_limit = kUnlimited, .epochs = 20, .seed = seed});
  }

  EnsemblePolicy ensemble_;
};

// Returns the first time step up to `until` whose score is above the threshold or NaN; -1: none.
int FirstAlarm(const ScoredEpisode& episode, double threshold, int until) {
  const int last = std::min(until, static_cast<int>(episode.scores.size()) - 1);
  for (int t = 0; t <= last; ++t) {
    if (!(episode.scores[static_cast<std::size_t>(t)] <= threshold)) return t;
  }
  return -1;
}

}  // namespace

std::unique_ptr<const Detector> MakeDetector(std::string_view name, const FittedTask& fit,
                                             const imitation::DemonstrationSet& demonstrations,
                                             std::uint64_t seed) {
  DFR_THROW_UNLESS(std::ranges::count(kDetectors, name) == 1,
                   "unknown detector '" << name << "'; valid: " << Join(kDetectors));
  if (name == "rnd") {
    return std::make_unique<Distillation>(fit.model().features(), demonstrations, seed);
  }
  if (name == "ensemble") return std::make_unique<Disagreement>(fit, demonstrations, seed);
  return std::make_unique<SupportDetector>(name == "guard" ? "whitened" : name, fit,
                                           demonstrations);
}

std::optional<double> DetectorRates::balanced_accuracy() const noexcept {
  if (failures == 0 || successes == 0) return std::nullopt;
  return 0.5 * (static_cast<double>(alarmed_failures) / failures + 1.0 -
                static_cast<double>(alarmed_successes) / successes);
}

std::optional<double> DetectorRates::lead() const {
  if (leads.empty()) return std::nullopt;
  return core::Quantile(std::vector<double>(leads.begin(), leads.end()), 0.5);
}

double CalibratedThreshold(std::span<const ScoredEpisode> demonstrations, int until, double alpha) {
  DFR_THROW_UNLESS(!demonstrations.empty(), "a threshold needs held-out demonstrations");
  std::vector<double> highest;
  highest.reserve(demonstrations.size());
  for (const ScoredEpisode& d : demonstrations) {
    const auto end = d.scores.begin() + std::min<std::ptrdiff_t>(until + 1, std::ssize(d.scores));
    highest.push_back(d.scores.begin() == end ? -std::numeric_limits<double>::infinity()
                                              : *std::max_element(d.scores.begin(), end));
  }
  const double threshold = kernel::ConformalThreshold(highest, alpha);
  return std::isfinite(threshold) ? threshold : *std::ranges::max_element(highest);
}

DetectorRates RatesOf(std::span<const ScoredEpisode> episodes, double threshold, int until) {
  DetectorRates rates;
  for (const ScoredEpisode& episode : episodes) {
    const int alarm = FirstAlarm(episode, threshold, until);
    ++(episode.failed ? rates.failures : rates.successes);
    if (alarm < 0) continue;
    ++(episode.failed ? rates.alarmed_failures : rates.alarmed_successes);
    if (episode.failed) rates.leads.push_back(static_cast<int>(episode.scores.size()) - 1 - alarm);
  }
  return rates;
}

}  // namespace dfr::study
