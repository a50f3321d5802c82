#include "apps/study/planar/coverage.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "apps/study/planar/task.h"
#include "dfr/control/certified/certificate_constants.h"
#include "dfr/core/contract.h"
#include "dfr/core/numerics/log_gamma.h"
#include "dfr/core/random.h"
#include "dfr/core/trajectory.h"
#include "dfr/kernel/model_selection.h"
#include "dfr/safety/guard_model.h"

namespace dfr::study::planar {
namespace {

// Student's t with 3 degrees of freedom.
double HeavyTailed(core::Random& random) {
  double square = 0.0;
  for (int i = 0; i < 3; ++i) square += std::pow(random.Normal(), 2);
  return random.Normal() / std::sqrt(square / 3.0);
}

// Returns demonstrations that move towards (1, ..., 1) in 8 actions. The plant rotates and scales
// each action and adds an error.
std::vector<core::Trajectory> Reach(int dim, bool heavy, int count, std::uint64_t seed) {
  constexpr int kSteps = 8;
  core::Random random(seed);
  const auto error = [&] { return heavy ? HeavyTailed(random) : random.Normal(); };
  std::vector<core::Trajectory> demonstrations(static_cast<std::size_t>(count));
  for (core::Trajectory& d : demonstrations) {
    d.states.resize(kSteps + 1, dim);
    d.controls.resize(kSteps, dim);
    for (double& x : d.states.row(0)) x = 0.2 * error();
    for (int t = 0; t < kSteps; ++t) {
      for (int k = 0; k < dim; ++k) {
        d.controls(t, k) = 0.3 * (1.0 - d.states(t, k)) + 0.05 * error();
      }
      const double size = d.controls.row(t).norm();
      for (int k = 0; k < dim; ++k) {
        d.states(t + 1, k) = d.states(t, k) + 0.9 * d.controls(t, k) -
                             0.3 * d.controls(t, (k + 1) % dim) + 0.05 * size * error();
      }
    }
    d.outcome = core::Outcome::kCompleted;
  }
  return demonstrations;
}

std::vector<core::Trajectory> Draw(const std::string& world, int count, std::uint64_t seed) {
  if (world == "corridor") return Demonstrate(MakeTask(world), count, seed);
  if (world == "reach") return Reach(6, false, count, seed);
  return Reach(2, true, count, seed);
}

// Probability of at most `most` successes in `n` trials whose success probability is Beta(a, b).
double BetaBinomial(int most, int n, double a, double b) {
  double sum = 0.0;
  for (int k = 0; k <= std::min(most, n); ++k) {
    sum +=
        std::exp(core::LogGamma(n + 1.0) - core::LogGamma(k + 1.0) - core::LogGamma(n - k + 1.0) +
                 core::LogGamma(k + a) + core::LogGamma(n - k + b) - core::LogGamma(n + a + b) +
                 core::LogGamma(a + b) - core::LogGamma(a) - core::LogGamma(b));
  }
  return sum;
}

// Returns the largest number of demonstrations that is at most the given share of `n`.
int AtMost(double share, int n) { return static_cast<int>(std::floor(share * n + 1e-9)); }

}  // namespace

const std::vector<std::string>& CoverageWorlds() {
  static const std::vector<std::string> names = {"corridor", "reach", "heavy-tails"};
  return names;
}

CoverageResult MeasureCoverage(const CoverageOptions& options) {
  const auto& worlds = CoverageWorlds();
  DFR_THROW_UNLESS(std::find(worlds.begin(), worlds.end(), options.world) != worlds.end(),
                   "unknown world '" << options.world << "'; valid: corridor, reach, heavy-tails");
  DFR_THROW_UNLESS(options.fits >= 2, "fits must be at least 2, not " << options.fits);
  DFR_THROW_UNLESS(options.further > 0, "further must be positive, not " << options.further);
  CoverageResult result;
  std::vector<double> rates;
  rates.reserve(static_cast<std::size_t>(options.fits));
  for (int fit = 0; fit < options.fits; ++fit) {
    const auto number = static_cast<std::uint64_t>(fit);
    const auto demonstrations =
        Draw(options.world, options.demonstrations, core::DeriveSeed(options.seed, {number, 0}));
    core::StateLayout layout;
    layout.Add("state", static_cast<int>(demonstrations[0].states.cols()));
    const auto model = safety::GuardModel::Fit(layout, demonstrations,
                                               {.false_alarms = options.false_alarms,
                                                .confidence = options.confidence,
                                                .hold_out = options.hold_out,
                                                .accept_any = true});
    const safety::GuardSummary& summary = model->summary();
    int alarms = 0;
    int error_below = 0;
    int gain_below = 0;
    for (const core::Trajectory& d :
         Draw(options.world, options.further, core::DeriveSeed(options.seed, {number, 1}))) {
      const std::vector<double> levels = model->Levels(d.states);
      alarms += *std::min_element(levels.begin(), levels.end()) < -model->settings().alarm_level;
      const control::FeatureTrajectories further(model->task().features(),
                                                 model->actions().Measured({&d, 1}));
      error_below += control::EstimateDirectionError(model->task().response(), further).value <=
                     summary.direction_error.value;
      gain_below += control::EstimateGain(further).value <= summary.gain.value;
    }
    rates.push_back(static_cast<double>(alarms) / options.further);
    result.promised = summary.false_alarms;
    result.confidence = summary.confidence;
    result.kept += alarms <= AtMost(summary.false_alarms, options.further) ? 1 : 0;
    result.error_short += error_below < summary.direction_error.coverage * options.further ? 1 : 0;
    result.gain_short += gain_below < summary.gain.coverage * options.further ? 1 : 0;
    if (summary.held_out == 0 || fit > 0) continue;
    // Coverage at a rank is Beta(rank, m + 1 - rank), and at the largest of m values Beta(m, 1).
    const int m = summary.held_out;
    std::vector<double> ranks(static_cast<std::size_t>(m));
    std::iota(ranks.begin(), ranks.end(), 1.0);
    const double rank = std::min<double>(
        m, kernel::ConformalThreshold(ranks, options.false_alarms, options.confidence));
    result.kept_chance = BetaBinomial(AtMost(summary.false_alarms, options.further),
                                      options.further, m + 1.0 - rank, rank);
    const double covered = summary.direction_error.coverage * options.further;
    result.short_chance =
        BetaBinomial(static_cast<int>(std::ceil(covered)) - 1, options.further, m, 1.0);
  }
  const double n = options.fits;
  result.mean = std::accumulate(rates.begin(), rates.end(), 0.0) / n;
  double square = 0.0;
  for (const double rate : rates) square += std::pow(rate - result.mean, 2);
  result.mean_error = std::sqrt(square / (n - 1.0) / n);
  return result;
}

}  // namespace dfr::study::planar
