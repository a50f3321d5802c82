#include "dfr/imitation/gaussian_policy.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/core/contract.h"

namespace dfr::imitation {
namespace {
constexpr std::string_view kGaussianPolicyKind = "gaussian-policy";
constexpr int kGaussianPolicyVersion = 1;
}  // namespace

GaussianPolicy::GaussianPolicy(MlpPolicy mean, Eigen::VectorXd log_std)
    : mean_(std::move(mean)), log_std_(std::move(log_std)) {
  DFR_THROW_UNLESS(log_std_.size() == mean_.control_dim(),
                   "the policy has " << mean_.control_dim() << " controls, and " << log_std_.size()
                                     << " log standard deviations");
  for (Eigen::Index i = 0; i < log_std_.size(); ++i) {
    DFR_THROW_UNLESS(std::isfinite(log_std_[i]),
                     "log standard deviation " << i << " is " << log_std_[i]);
  }
}

void GaussianPolicy::Sample(std::span<const double> x, core::Random& random,
                            std::span<double> u) const noexcept {
  mean_.Unlimited(x, u);
  for (std::size_t i = 0; i < u.size(); ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    const double limit = mean_.control_limit()[k];
    u[i] = std::clamp(u[i] + std::exp(log_std_[k]) * random.Normal(), -limit, limit);
  }
}

void GaussianPolicy::Save(const std::filesystem::path& path) const {
  core::ArchiveWriter archive(kGaussianPolicyKind, kGaussianPolicyVersion);
  mean_.Save(archive);
  archive.Numbers(core::AsSpan(log_std_));
  archive.Save(path);
}

GaussianPolicy GaussianPolicy::Load(const std::filesystem::path& path) {
  core::ArchiveReader archive(path, kGaussianPolicyKind, kGaussianPolicyVersion);
  MlpPolicy mean = MlpPolicy::Load(archive);
  const std::vector<double> log_std = archive.Numbers();
  archive.End();
  try {
    return {std::move(mean), core::AsVector(log_std)};
  } catch (const std::invalid_argument& e) {
    archive.Fail(e.what());
  }
}

}  // namespace dfr::imitation
