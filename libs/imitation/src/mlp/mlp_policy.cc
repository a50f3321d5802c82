#include "dfr/imitation/mlp_policy.h"

#include <algorithm>
#include <array>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

#include "checks.h"
#include "dfr/core/contract.h"

namespace dfr::imitation {
namespace {

constexpr std::string_view kMlpPolicyKind = "mlp-policy";
constexpr int kMlpPolicyVersion = 1;

}  // namespace

MlpPolicy::MlpPolicy(core::StateLayout layout, std::string_view features, Whitening whitening,
                     Mlp mlp, Eigen::VectorXd control_limit)
    : layout_(std::move(layout)),
      selection_(core::FeatureSelection::Of(layout_, features)),
      whitening_(std::move(whitening)),
      mlp_(std::move(mlp)),
      control_limit_(std::move(control_limit)) {
  for (core::StateLayout::Block& block : layout_.blocks) block.picture = {};
  DFR_THROW_UNLESS(whitening_.dim() == selection_.num_features(),
                   "the policy selects " << selection_.num_features()
                                         << " features, but its whitening "
                                         << "has " << whitening_.dim());
  DFR_THROW_UNLESS(mlp_.input_dim() == selection_.num_features(),
                   "the policy selects " << selection_.num_features()
                                         << " features, but its network takes "
                                         << mlp_.input_dim());
  DFR_THROW_UNLESS(control_limit_.size() == mlp_.output_dim(),
                   "the policy's network has " << mlp_.output_dim() << " outputs, and "
                                               << control_limit_.size() << " control limits");
  for (Eigen::Index i = 0; i < control_limit_.size(); ++i) {
    DFR_THROW_UNLESS(control_limit_[i] > 0.0,  // infinity means no limit
                     "control limit " << i << " is " << control_limit_[i] << ", not positive");
  }
}

void MlpPolicy::Unlimited(std::span<const double> x, std::span<double> u) const noexcept {
  const bool usable = static_cast<int>(x.size()) == state_dim() && core::AllFinite(x);
  if (usable) {
    std::array<double, Mlp::kMaxWidth> buffer;
    const std::span<double> features(buffer.data(), static_cast<std::size_t>(mlp_.input_dim()));
    selection_.Apply(x, features);
    whitening_.Apply(features, features);
    mlp_.Forward(features, u);
  }
  if (!usable || !core::AllFinite(u)) {
    std::fill(u.begin(), u.end(), std::numeric_limits<double>::quiet_NaN());
  }
}

void MlpPolicy::Control(int /*t*/, std::span<const double> x, std::span<double> u) const noexcept {
  Unlimited(x, u);
  for (std::size_t i = 0; i < u.size(); ++i) {
    const double limit = control_limit_[static_cast<Eigen::Index>(i)];
    u[i] = std::clamp(u[i], -limit, limit);  // NaN passes
  }
}

void MlpPolicy::Save(core::ArchiveWriter& archive) const {
  archive.Integer(static_cast<std::int64_t>(layout_.blocks.size()));
  for (const auto& block : layout_.blocks) {
    archive.Text(block.name);
    archive.Integer(block.size);
  }
  archive.Text(selection_.spec());
  whitening_.Save(archive);
  mlp_.Save(archive);
  archive.Numbers(core::AsSpan(control_limit_));
}

MlpPolicy MlpPolicy::Load(core::ArchiveReader& archive) {
  try {
    core::StateLayout layout;
    const int blocks = archive.IntegerIn(1, 1 << 16);
    for (int i = 0; i < blocks; ++i) {
      std::string name = archive.Text();
      layout.Add(std::move(name), archive.IntegerIn(1, 1 << 20));
    }
    const std::string features = archive.Text();
    Whitening whitening = Whitening::Load(archive);
    Mlp mlp = Mlp::Load(archive);
    const std::vector<double> limit = archive.Numbers();
    return {std::move(layout), features, std::move(whitening), std::move(mlp),
            core::AsVector(limit)};
  } catch (const std::invalid_argument& e) {
    archive.Fail(e.what());
  }
}

void MlpPolicy::Save(const std::filesystem::path& path) const {
  core::ArchiveWriter archive(kMlpPolicyKind, kMlpPolicyVersion);
  Save(archive);
  archive.Save(path);
}

MlpPolicy MlpPolicy::Load(const std::filesystem::path& path) {
  core::ArchiveReader archive(path, kMlpPolicyKind, kMlpPolicyVersion);
  MlpPolicy policy = Load(archive);
  archive.End();
  return policy;
}

}  // namespace dfr::imitation
