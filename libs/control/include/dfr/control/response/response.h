#pragma once

#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "dfr/control/response/transition_store.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/core/files/archive.h"
#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"

namespace dfr::control {

/// Demonstrations in features: each has one matrix of points (T + 1 rows) and one matrix of
/// controls (T rows).
struct FeatureTrajectories {
  FeatureTrajectories() = default;
  /// @throws std::invalid_argument naming the demonstration whose number of states is not its
  /// number of controls plus 1, or which has a non-finite entry.
  FeatureTrajectories(const core::FeatureTransform& features,
                      std::span<const core::Trajectory> demonstrations);

  std::vector<core::Matrix> points;
  std::vector<core::Matrix> controls;
  /// The contexts for TransitionStore; empty if there are none.
  std::vector<core::Matrix> contexts;
};

/// Returns the root mean square of |u| over the nonzero controls of all demonstrations.
/// @throws std::invalid_argument if all controls are zero.
[[nodiscard]] double RootMeanSquare(std::span<const core::Matrix> controls);

/// Response of features to controls in demonstrations. Immutable; copies share the transitions.
class Response {
 public:
  /// @param going_on  called for each left-out demonstration of each comparison. If it returns
  ///   false, the fit stops, and the response must not be used.
  /// @throws std::invalid_argument if shapes do not match, all controls are zero, or an option is
  /// out of range.
  explicit Response(const FeatureTrajectories& demonstrations, const ResponseOptions& options = {},
                    const std::function<bool()>& going_on = {});

  /// Appends this object to a file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote. @throws std::runtime_error naming the file and its defect.
  static Response Load(core::ArchiveReader& archive);

  [[nodiscard]] int feature_dim() const noexcept { return prior_->feature_dim(); }
  [[nodiscard]] int control_dim() const noexcept { return prior_->control_dim(); }
  [[nodiscard]] const std::shared_ptr<const TransitionStore>& prior() const noexcept {
    return prior_;
  }
  /// Returns `us`, the root mean square of |u|: the unit of v = u / us.
  [[nodiscard]] double control_unit() const noexcept { return control_unit_; }
  /// Returns the largest demonstrated |v|.
  [[nodiscard]] double largest_control() const noexcept { return largest_; }
  /// Returns, for each entry of v, its demonstrated values in ascending order; none if there is
  /// only one value or there are many (FewValues).
  [[nodiscard]] const std::vector<std::vector<double>>& values() const noexcept { return values_; }
  /// Returns true if features move without controls: on held-out demonstrations, a drift explains
  /// at least 40 % of the variance unexplained by controls. Otherwise the estimate is more accurate
  /// without a drift.
  [[nodiscard]] bool has_drift() const noexcept { return has_drift_; }

 private:
  Response() = default;

  std::shared_ptr<const TransitionStore> prior_;
  double control_unit_ = 1.0;
  double largest_ = 0.0;
  std::vector<std::vector<double>> values_;
  bool has_drift_ = false;
};

}  // namespace dfr::control
