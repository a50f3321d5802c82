#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>

#include "dfr/core/features/features.h"
#include "dfr/core/files/archive.h"
#include "dfr/core/policy.h"
#include "dfr/imitation/mlp.h"
#include "dfr/imitation/whitening.h"

namespace dfr::imitation {

/// A network as a policy: u = clip(mlp(whitening(features(x))), -limit, limit). Ignores t.
/// Immutable; concurrent calls are safe.
class MlpPolicy final : public core::Policy {
 public:
  /// @param layout  blocks of the state. The policy and its files keep the names and sizes of the
  ///   blocks, by which a program can reject a plant with other states. They do not keep the shapes
  ///   of pictures.
  /// @param features  as in core::FeatureSelection; empty for the whole state.
  /// @param whitening  standardises the features.
  /// @param mlp  maps standardised features to controls.
  /// @param control_limit  limit of each control entry, > 0: the actuators' range.
  /// @throws std::invalid_argument naming the arguments that do not fit together.
  MlpPolicy(core::StateLayout layout, std::string_view features, Whitening whitening, Mlp mlp,
            Eigen::VectorXd control_limit);

  [[nodiscard]] int state_dim() const noexcept override { return selection_.state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return mlp_.output_dim(); }

  /// Writes NaN to all entries of `u` if an entry of x is not finite or x has the wrong size. Never
  /// allocates.
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override;

  /// Same as Control(), but without the control limit. A Gaussian policy adds its noise to this
  /// output.
  void Unlimited(std::span<const double> x, std::span<double> u) const noexcept;

  [[nodiscard]] const core::StateLayout& layout() const noexcept { return layout_; }
  [[nodiscard]] const core::FeatureSelection& selection() const noexcept { return selection_; }
  [[nodiscard]] const Whitening& whitening() const noexcept { return whitening_; }
  [[nodiscard]] const Mlp& mlp() const noexcept { return mlp_; }
  [[nodiscard]] const Eigen::VectorXd& control_limit() const noexcept { return control_limit_; }

  /// Writes a file of kind "mlp-policy". @throws std::runtime_error naming the file.
  void Save(const std::filesystem::path& path) const;
  /// @throws std::runtime_error naming the file and the problem.
  static MlpPolicy Load(const std::filesystem::path& path);

  /// Appends the policy to another file.
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
