#include "dfr/core/features/feature_decision.h"

#include <algorithm>
#include <array>
#include <limits>
#include <utility>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"
#include "dfr/core/numerics/linear_algebra.h"

namespace dfr::core {
namespace {

constexpr double kOutside = -std::numeric_limits<double>::infinity();

using Buffer = std::array<double, FeatureTransform::kMaxFeatures>;

}  // namespace

FeatureDecision::FeatureDecision(FeatureTransform features, const LogDecisionFunction& inner)
    : features_(std::move(features)), inner_(&inner), norm_(OperatorNorm(features_.scale())) {
  DFR_THROW_UNLESS(features_.num_features() == inner.state_dim(),
                   "there are " << features_.num_features()
                                << " features, but the decision function takes "
                                << inner.state_dim());
  DFR_THROW_UNLESS(features_.num_features() <= FeatureTransform::kMaxFeatures,
                   "at most " << FeatureTransform::kMaxFeatures << " features are supported, not "
                              << features_.num_features());
}

double FeatureDecision::Decision(int t, std::span<const double> x) const noexcept {
  if (static_cast<int>(x.size()) != state_dim()) return kOutside;
  Buffer buffer;
  const std::span<double> z(buffer.data(), static_cast<std::size_t>(features_.num_features()));
  features_.Apply(x, z);
  return inner_->Decision(t, z);
}

double FeatureDecision::Gradient(int t, std::span<const double> x,
                                 std::span<double> gradient) const noexcept {
  std::fill(gradient.begin(), gradient.end(), 0.0);
  if (static_cast<int>(x.size()) != state_dim() || gradient.size() != x.size()) return kOutside;
  Buffer buffer;
  Buffer inner_buffer;
  const auto n = static_cast<std::size_t>(features_.num_features());
  const std::span<double> z(buffer.data(), n);
  const std::span<double> inner(inner_buffer.data(), n);
  features_.Apply(x, z);
  const double g = inner_->Gradient(t, z, inner);
  if (g > kOutside) Pull(x, inner, gradient);
  return g;
}

double FeatureDecision::LogDecision(int t, std::span<const double> x,
                                    std::span<double> gradient) const noexcept {
  std::fill(gradient.begin(), gradient.end(), 0.0);
  if (static_cast<int>(x.size()) != state_dim()) return kOutside;
  if (!gradient.empty() && gradient.size() != x.size()) return kOutside;
  Buffer buffer;
  const auto n = static_cast<std::size_t>(features_.num_features());
  const std::span<double> z(buffer.data(), n);
  features_.Apply(x, z);
  if (gradient.empty()) return inner_->LogDecision(t, z, {});
  Buffer inner_buffer;
  const std::span<double> inner(inner_buffer.data(), n);
  const double l = inner_->LogDecision(t, z, inner);
  if (l > kOutside) Pull(x, inner, gradient);
  return l;
}

void FeatureDecision::Pull(std::span<const double> x, std::span<const double> inner,
                           std::span<double> gradient) const noexcept {
  const std::vector<int>& indices = features_.selection().indices();
  const Matrix& scale = features_.scale();
  Buffer slopes;
  features_.selection().Slopes(x, slopes);
  for (Eigen::Index k = 0; k < scale.cols(); ++k) {
    const int entry = indices[static_cast<std::size_t>(k)];
    gradient[static_cast<std::size_t>(entry)] +=
        slopes[static_cast<std::size_t>(k)] * scale.col(k).dot(AsVector(inner));
  }
}

}  // namespace dfr::core
