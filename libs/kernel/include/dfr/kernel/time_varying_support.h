#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <span>
#include <vector>

#include "dfr/core/decision_function.h"
#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"

namespace dfr::kernel {

/// Options for TimeVaryingSupport::Fit().
struct TimeVaryingSupportOptions {
  /// Options of each estimate; one weight per demonstration. Calls of `progress` come from all
  /// threads but do not overlap, and end with the first false.
  OneClassSvmOptions svm = {};
  /// Number of time steps t = 0, 1, ... with an estimate; 0: the number of states of the longest
  /// demonstration.
  int num_steps = 0;
  /// If true, fits a single estimate to the states of all time steps. For comparison only: Sec.
  /// IV-A advises against a single estimate.
  bool pooled = false;
  /// Number of threads, >= 0; 0: one per core. The estimates have the same bits for any number.
  /// Replaces `svm.threads`, which is ignored.
  int threads = 1;
};

/// Support of the demonstrated states at each time step (Sec. IV-A): one OneClassSvm g_t per t,
/// fitted to the states of all demonstrations at t. A demonstration that ends early contributes its
/// last state from then on, because the robot rests in that state.
///
/// Immutable after construction. Copies are cheap because they share data. Concurrent calls are
/// safe.
class TimeVaryingSupport final : public core::LogDecisionFunction {
 public:
  /// Fits to one matrix of states per demonstration, (T_i + 1) x n, rows in time order. If given,
  /// `summaries` receives one entry per estimate.
  /// @throws std::invalid_argument if there are fewer than two demonstrations (pooled: two states),
  ///   one is empty, their widths differ, an entry is not finite, or an option is out of range. The
  ///   message names the demonstration and row.
  static TimeVaryingSupport Fit(std::span<const core::Matrix> demonstrations,
                                const TimeVaryingSupportOptions& options,
                                std::vector<FitSummary>* summaries = nullptr);
  /// Overload for demonstrations in memory owned elsewhere, for example by NumPy.
  static TimeVaryingSupport Fit(std::span<const Eigen::Map<const core::Matrix>> demonstrations,
                                const TimeVaryingSupportOptions& options,
                                std::vector<FitSummary>* summaries = nullptr);

  /// Combines estimates, g_0 first. @throws std::invalid_argument if there are none or their state
  /// sizes differ.
  explicit TimeVaryingSupport(std::vector<OneClassSvm> estimates);

  /// Writes all estimates, bit for bit, to a file in this project's format. @throws
  /// std::runtime_error naming the file and the system's message.
  void Save(const std::filesystem::path& path) const;
  /// @throws std::runtime_error naming the file and the problem.
  static TimeVaryingSupport Load(const std::filesystem::path& path);

  [[nodiscard]] int state_dim() const noexcept override;
  /// Returns 1 for a pooled estimate.
  [[nodiscard]] int num_steps() const noexcept override;
  [[nodiscard]] double Decision(int t, std::span<const double> x) const noexcept override;
  double Gradient(int t, std::span<const double> x,
                  std::span<double> gradient) const noexcept override;
  double LogDecision(int t, std::span<const double> x,
                     std::span<double> gradient) const noexcept override;
  [[nodiscard]] double FromLog(int t, double l) const noexcept override;
  /// Returns gamma (see OneClassSvm::LogGradient()).
  [[nodiscard]] double curvature_bound(int t) const noexcept override;

  /// Returns g_t; times out of range use the nearest estimate.
  [[nodiscard]] const OneClassSvm& at(int t) const noexcept;

 private:
  std::vector<OneClassSvm> estimates_;
};

}  // namespace dfr::kernel
