#include "dfr/kernel/time_varying_support.h"

#include <algorithm>
#include <atomic>
#include <optional>
#include <stdexcept>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/files/archive.h"
#include "dfr/core/workers.h"
#include "support/fit_sharing.h"
#include "support/states_at.h"

namespace dfr::kernel {
namespace {

constexpr int kMostSteps = 1'000'000;  // limit for options and files

constexpr char kKind[] = "time-varying-support";
constexpr int kVersion = 1;

core::Matrix AllStates(std::span<const internal::StatesView> demonstrations, int num_steps) {
  Eigen::Index count = 0;
  for (const internal::StatesView& states : demonstrations) {
    count += std::min<Eigen::Index>(states.rows(), num_steps);
  }
  core::Matrix pool(count, demonstrations[0].cols());
  Eigen::Index row = 0;
  for (const internal::StatesView& states : demonstrations) {
    const Eigen::Index rows = std::min<Eigen::Index>(states.rows(), num_steps);
    pool.middleRows(row, rows) = states.topRows(rows);
    row += rows;
  }
  return pool;
}

// Returns the weight of each row of AllStates(): that of its demonstration.
std::vector<double> AllWeights(std::span<const internal::StatesView> demonstrations, int num_steps,
                               std::span<const double> weights) {
  DFR_THROW_UNLESS(weights.size() == demonstrations.size(),
                   "there are " << weights.size() << " weights for " << demonstrations.size()
                                << " demonstrations");
  std::vector<double> all;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    const auto rows = std::min<Eigen::Index>(demonstrations[i].rows(), num_steps);
    all.insert(all.end(), static_cast<std::size_t>(rows), weights[i]);
  }
  return all;
}

}  // namespace

TimeVaryingSupport TimeVaryingSupport::Fit(std::span<const core::Matrix> demonstrations,
                                           const TimeVaryingSupportOptions& options,
                                           std::vector<FitSummary>* summaries) {
  return Fit(std::span<const internal::StatesView>(internal::Views(demonstrations)), options,
             summaries);
}

TimeVaryingSupport TimeVaryingSupport::Fit(
    std::span<const Eigen::Map<const core::Matrix>> demonstrations,
    const TimeVaryingSupportOptions& options, std::vector<FitSummary>* summaries) {
  const internal::NuGamma own[] = {{options.svm.nu, options.svm.gamma}};
  return std::move(internal::FitGrid(demonstrations, options, own, summaries)[0]);
}

std::vector<TimeVaryingSupport> internal::FitGrid(std::span<const StatesView> demonstrations,
                                                  const TimeVaryingSupportOptions& options,
                                                  std::span<const NuGamma> grid,
                                                  std::vector<FitSummary>* summaries) {
  DFR_THROW_UNLESS(options.num_steps >= 0, "num_steps must not be negative: " << options.num_steps);
  DFR_THROW_UNLESS(options.num_steps <= kMostSteps,
                   "num_steps must be " << kMostSteps << " at most, not " << options.num_steps);
  DFR_THROW_UNLESS(options.threads >= 0, "threads must not be negative: " << options.threads);
  CheckDemonstrations(demonstrations);
  const int num_steps = options.num_steps > 0 ? options.num_steps : LongestLength(demonstrations);
  DFR_THROW_UNLESS(options.pooled || demonstrations.size() >= 2,
                   "an estimate per time step needs at least 2 demonstrations; there is 1");

  const std::size_t count = options.pooled ? 1 : static_cast<std::size_t>(num_steps);
  std::vector<std::optional<OneClassSvm>> fitted(grid.size() * count);
  std::vector<FitSummary> results(fitted.size());
  const std::vector<double> weights =
      options.pooled && !options.svm.weights.empty()
          ? AllWeights(demonstrations, num_steps, options.svm.weights)
          : std::vector<double>();
  SharedProgress progress(options.svm.progress);
  // A pooled fit distributes its own work.
  core::Workers workers(options.pooled ? 1 : options.threads);
  // Each worker takes the next time step and uses separate memory.
  std::atomic<std::size_t> next = 0;
  workers.Run(std::min(workers.size(), count), [&](std::size_t) {
    Scratch alone;
    for (std::size_t t = next++; t < count; t = next++) {
      const core::Matrix samples = options.pooled ? AllStates(demonstrations, num_steps)
                                                  : StatesAt(demonstrations, static_cast<int>(t));
      SharedDistances distances(samples);
      Scratch together(&distances);
      OneClassSvmOptions svm = options.svm;
      svm.threads = options.pooled ? options.threads : 1;
      svm.progress = progress.callback();
      if (!weights.empty()) svm.weights = weights;
      for (std::size_t g = 0; g < grid.size(); ++g) {
        svm.nu = grid[g].nu;
        svm.gamma = grid[g].gamma;
        const std::size_t index = g * count + t;
        fitted[index] =
            FitSharing(samples, svm, grid.size() > 1 ? together : alone, &results[index]);
      }
    }
  });

  std::vector<TimeVaryingSupport> supports;
  for (std::size_t g = 0; g < grid.size(); ++g) {
    std::vector<OneClassSvm> estimates;
    estimates.reserve(count);
    for (std::size_t t = 0; t < count; ++t) estimates.push_back(std::move(*fitted[g * count + t]));
    supports.emplace_back(std::move(estimates));
  }
  if (summaries != nullptr) *summaries = std::move(results);
  return supports;
}

TimeVaryingSupport::TimeVaryingSupport(std::vector<OneClassSvm> estimates)
    : estimates_(std::move(estimates)) {
  DFR_THROW_UNLESS(!estimates_.empty(), "a support needs at least one estimate");
  for (const OneClassSvm& estimate : estimates_) {
    DFR_THROW_UNLESS(estimate.state_dim() == estimates_[0].state_dim(),
                     "estimates have states of " << estimates_[0].state_dim() << " and of "
                                                 << estimate.state_dim() << " entries");
  }
}

void TimeVaryingSupport::Save(const std::filesystem::path& path) const {
  core::ArchiveWriter file(kKind, kVersion);
  file.Integer(num_steps());
  for (const OneClassSvm& estimate : estimates_) {
    file.Number(estimate.gamma());
    file.Number(estimate.rho());
    file.Number(estimate.libsvm_scale());
    file.Numbers(core::AsSpan(estimate.alpha()));
    file.MatrixBlock(estimate.support_vectors());
  }
  file.Save(path);
}

TimeVaryingSupport TimeVaryingSupport::Load(const std::filesystem::path& path) {
  core::ArchiveReader file(path, kKind, kVersion);
  const int num_steps = file.IntegerIn(1, kMostSteps);
  std::vector<OneClassSvm> estimates;
  for (int t = 0; t < num_steps; ++t) {
    const double gamma = file.Number();
    const double rho = file.Number();
    // With rho <= 0, every state would be inside.
    if (!(rho > 0.0)) file.Fail("rho must be positive");
    const double scale = file.Number();
    const std::vector<double> alpha = file.Numbers();
    core::Matrix support_vectors = file.MatrixBlock();
    try {
      estimates.push_back(OneClassSvm::FromParts(std::move(support_vectors), core::AsVector(alpha),
                                                 gamma, rho, scale));
    } catch (const std::invalid_argument& e) {
      file.Fail("estimate " + std::to_string(t) + ": " + e.what());
    }
  }
  file.End();
  try {
    return TimeVaryingSupport(std::move(estimates));
  } catch (const std::invalid_argument& e) {
    file.Fail(e.what());
  }
}

const OneClassSvm& TimeVaryingSupport::at(int t) const noexcept {
  return estimates_[static_cast<std::size_t>(std::clamp(t, 0, num_steps() - 1))];
}

int TimeVaryingSupport::state_dim() const noexcept { return estimates_[0].state_dim(); }

int TimeVaryingSupport::num_steps() const noexcept { return static_cast<int>(estimates_.size()); }

double TimeVaryingSupport::Decision(int t, std::span<const double> x) const noexcept {
  return at(t).Decision(x);
}

double TimeVaryingSupport::Gradient(int t, std::span<const double> x,
                                    std::span<double> gradient) const noexcept {
  return at(t).Gradient(x, gradient);
}

double TimeVaryingSupport::LogDecision(int t, std::span<const double> x,
                                       std::span<double> gradient) const noexcept {
  return gradient.empty() ? at(t).LogDecision(x) : at(t).LogGradient(x, gradient);
}

double TimeVaryingSupport::FromLog(int t, double l) const noexcept { return at(t).FromLog(l); }

double TimeVaryingSupport::curvature_bound(int t) const noexcept { return at(t).gamma(); }

}  // namespace dfr::kernel
