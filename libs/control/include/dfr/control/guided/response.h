#pragma once

#include <memory>
#include <span>
#include <vector>

#include "dfr/control/guided/transition_store.h"
#include "dfr/core/archive.h"
#include "dfr/core/feature_transform.h"
#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"

namespace dfr::control {

/// Demonstrations in features: one matrix of points (T + 1 rows) and one of controls (T rows) each.
struct FeatureTrajectories {
  FeatureTrajectories() = default;
  /// @throws std::invalid_argument naming the demonstration that has not one state more than
  ///   controls, or a non-finite entry.
  FeatureTrajectories(const core::FeatureTransform& features,
                      std::span<const core::Trajectory> demonstrations);

  std::vector<core::Matrix> points;
  std::vector<core::Matrix> controls;
};

/// How features answered controls in demonstrations. A value; immutable, copies share the
/// transitions.
class Response {
 public:
  /// @throws std::invalid_argument if shapes do not fit, no control differs from zero, or an option
  ///   is out of range.
  explicit Response(const FeatureTrajectories& demonstrations, const ResponseOptions& options = {});

  /// Appends all of it to a file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote. @throws std::runtime_error naming the file and what is wrong with it.
  static Response Load(core::ArchiveReader& archive);

  [[nodiscard]] int feature_dim() const noexcept { return prior_->feature_dim(); }
  [[nodiscard]] int control_dim() const noexcept { return prior_->control_dim(); }
  [[nodiscard]] const std::shared_ptr<const TransitionStore>& prior() const noexcept {
    return prior_;
  }
  /// us, the root mean square of |u|: the unit of v = u / us.
  [[nodiscard]] double control_unit() const noexcept { return control_unit_; }
  /// Largest demonstrated |v|.
  [[nodiscard]] double largest_control() const noexcept { return largest_; }
  /// Whether features move by themselves: what they do explains, of demonstrations that an estimate
  /// has not seen, at least 40 % of what controls leave unexplained. Where it explains less, the
  /// estimate is better without.
  [[nodiscard]] bool has_drift() const noexcept { return has_drift_; }

 private:
  Response() = default;

  std::shared_ptr<const TransitionStore> prior_;
  double control_unit_ = 1.0;
  double largest_ = 0.0;
  bool has_drift_ = false;
};

}  // namespace dfr::control
