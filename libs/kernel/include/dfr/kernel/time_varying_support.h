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
  OneClassSvmOptions svm = {};  ///< The same for every time step; `weights`: one a demonstration.
  /// How many time steps t = 0, 1, ... get an estimate; 0: as many as the longest demonstration has
  /// states.
  int num_steps = 0;
  /// Fit one estimate to the states of all time steps instead. Sec. IV-A warns of this; it is here
  /// for comparison.
  bool pooled = false;
  /// Threads, >= 0; 0: one per core. The estimates have the same bits with any number. Stands for
  /// `svm.threads`, which is ignored.
  int threads = 1;
};

/// The support of the demonstrated states at each time step (Sec. IV-A): one OneClassSvm g_t per t,
/// fitted to the states that all demonstrations were in at t. A demonstration that ends early
/// counts with its last state from then on, because it rests there.
///
/// Immutable once made, and cheap to copy: copies share their data. Concurrent calls are safe.
class TimeVaryingSupport final : public core::LogDecisionFunction {
 public:
  /// Fits to one matrix of states a demonstration, (T_i + 1) x n, rows in order of time.
  /// `summaries`, if given, receives one entry per estimate.
  /// @throws std::invalid_argument if there are fewer than two demonstrations (pooled: two states),
  ///   one is empty, their widths differ, an entry is not finite, or an option is out of range; the
  ///   message names the demonstration and row.
  static TimeVaryingSupport Fit(std::span<const core::Matrix> demonstrations,
                                const TimeVaryingSupportOptions& options,
                                std::vector<FitSummary>* summaries = nullptr);
  /// The same for demonstrations in memory that others own, NumPy's say.
  static TimeVaryingSupport Fit(std::span<const Eigen::Map<const core::Matrix>> demonstrations,
                                const TimeVaryingSupportOptions& options,
                                std::vector<FitSummary>* summaries = nullptr);

  /// Puts estimates together, g_0 first. @throws std::invalid_argument if there are none or their
  ///   state sizes differ.
  explicit TimeVaryingSupport(std::vector<OneClassSvm> estimates);

  /// Writes all estimates, bit for bit, to a file of ours. @throws std::runtime_error naming the
  ///   file and what the system said.
  void Save(const std::filesystem::path& path) const;
  /// @throws std::runtime_error naming the file and what is wrong with it.
  static TimeVaryingSupport Load(const std::filesystem::path& path);

  [[nodiscard]] int state_dim() const noexcept override;
  /// One for a pooled estimate.
  [[nodiscard]] int num_steps() const noexcept override;
  [[nodiscard]] double Decision(int t, std::span<const double> x) const noexcept override;
  double Gradient(int t, std::span<const double> x,
                  std::span<double> gradient) const noexcept override;
  [[nodiscard]] double lipschitz_bound(int t) const noexcept override;
  double LogDecision(int t, std::span<const double> x,
                     std::span<double> gradient) const noexcept override;
  [[nodiscard]] double FromLog(int t, double l) const noexcept override;
  /// gamma (OneClassSvm::LogGradient()).
  [[nodiscard]] double curvature_bound(int t) const noexcept override;

  /// g_t; times out of range use the nearest one.
  [[nodiscard]] const OneClassSvm& at(int t) const noexcept;

 private:
  std::vector<OneClassSvm> estimates_;
};

}  // namespace dfr::kernel
