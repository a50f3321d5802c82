#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>

#include "dfr/core/archive.h"
#include "dfr/core/features.h"
#include "dfr/core/policy.h"
#include "dfr/imitation/mlp.h"
#include "dfr/imitation/whitening.h"

namespace dfr::imitation {

/// A network as a policy: u = clip(mlp(whitening(features(x))), -limit, limit). Ignores t.
/// Immutable; concurrent calls are safe.
class MlpPolicy final : public core::Policy {
 public:
  /// @param layout  the entries of the state. Files carry it, so that a policy cannot be run on a
  ///   plant with other states unnoticed.
  /// @param features  as in core::FeatureSelection; empty for the whole state.
  /// @param whitening  of the features.
  /// @param mlp  from whitened features to controls.
  /// @param control_limit  per entry of the control, > 0: the actuators' range.
  /// @throws std::invalid_argument if these do not fit together; the message names which.
  MlpPolicy(core::StateLayout layout, std::string_view features, Whitening whitening, Mlp mlp,
            Eigen::VectorXd control_limit);

  [[nodiscard]] int state_dim() const noexcept override { return selection_.state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return mlp_.output_dim(); }

  /// All entries of `u` are NaN where an entry of x is not finite, or x has the wrong size. Never
  /// allocates.
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override;

  /// The network's output itself, without the limit: what a Gaussian policy adds its noise to.
  /// Otherwise as Control().
  void Unlimited(std::span<const double> x, std::span<double> u) const noexcept;

  [[nodiscard]] const core::StateLayout& layout() const noexcept { return layout_; }
  [[nodiscard]] const core::FeatureSelection& selection() const noexcept { return selection_; }
  [[nodiscard]] const Whitening& whitening() const noexcept { return whitening_; }
  [[nodiscard]] const Mlp& mlp() const noexcept { return mlp_; }
  [[nodiscard]] const Eigen::VectorXd& control_limit() const noexcept { return control_limit_; }

  /// Writes a file of its own, kind "mlp-policy". @throws std::runtime_error naming the file.
  void Save(const std::filesystem::path& path) const;
  /// @throws std::runtime_error naming the file and what is wrong with it.
  static MlpPolicy Load(const std::filesystem::path& path);

  /// As part of another file.
  void Save(core::ArchiveWriter& archive) const;
  static MlpPolicy Load(core::ArchiveReader& archive);

 private:
  core::StateLayout layout_;
  core::FeatureSelection selection_;
  Whitening whitening_;
  Mlp mlp_;
  Eigen::VectorXd control_limit_;
};

}  // namespace dfr::imitation
