#include "dfr/imitation/whitening.h"

#include <cmath>
#include <stdexcept>
#include <utility>
#include <vector>

#include "checks.h"
#include "dfr/core/contract.h"

namespace dfr::imitation {

Whitening Whitening::Identity(int dim) {
  DFR_THROW_UNLESS(dim > 0, "whitening needs at least one feature, not " << dim);
  return {Eigen::VectorXd::Zero(dim), Eigen::VectorXd::Ones(dim)};
}

Whitening Whitening::FromData(const core::Matrix& samples) {
  DFR_THROW_UNLESS(samples.rows() > 0 && samples.cols() > 0,
                   "whitening needs at least one row and one column, not "
                       << samples.rows() << " x " << samples.cols());
  internal::CheckFinite(samples, "whitening samples");
  const Eigen::VectorXd mean = samples.colwise().mean().transpose();
  Eigen::VectorXd scale(samples.cols());
  for (Eigen::Index j = 0; j < samples.cols(); ++j) {
    const double deviation = std::sqrt((samples.col(j).array() - mean[j]).square().mean());
    scale[j] = deviation > 1e-9 * samples.col(j).cwiseAbs().maxCoeff() ? deviation : 1.0;
  }
  return {mean, scale};
}

Whitening::Whitening(Eigen::VectorXd mean, Eigen::VectorXd scale)
    : mean_(std::move(mean)), scale_(std::move(scale)) {
  DFR_THROW_UNLESS(mean_.size() > 0 && mean_.size() == scale_.size(),
                   "whitening needs a mean and a scale for each feature, not "
                       << mean_.size() << " and " << scale_.size());
  for (Eigen::Index j = 0; j < mean_.size(); ++j) {
    DFR_THROW_UNLESS(std::isfinite(mean_[j]),
                     "whitening mean of feature " << j << " is " << mean_[j]);
    DFR_THROW_UNLESS(
        std::isfinite(scale_[j]) && scale_[j] > 0.0,
        "whitening scale of feature " << j << " is " << scale_[j] << ", not positive and finite");
  }
}

void Whitening::Apply(std::span<const double> x, std::span<double> z) const noexcept {
  for (std::size_t j = 0; j < x.size(); ++j) {
    const auto k = static_cast<Eigen::Index>(j);
    z[j] = (x[j] - mean_[k]) / scale_[k];
  }
}

core::Matrix Whitening::Apply(const core::Matrix& samples) const {
  DFR_THROW_UNLESS(samples.cols() == dim(), "whitening has " << dim()
                                                             << " features, but the samples have "
                                                             << samples.cols());
  core::Matrix whitened(samples.rows(), samples.cols());
  for (Eigen::Index i = 0; i < samples.rows(); ++i) {
    Apply(core::Row(samples, i), core::Row(whitened, i));
  }
  return whitened;
}

void Whitening::Save(core::ArchiveWriter& archive) const {
  archive.Numbers(core::AsSpan(mean_));
  archive.Numbers(core::AsSpan(scale_));
}

Whitening Whitening::Load(core::ArchiveReader& archive) {
  const std::vector<double> mean = archive.Numbers();
  const std::vector<double> scale = archive.Numbers();
  try {
    return {core::AsVector(mean), core::AsVector(scale)};
  } catch (const std::invalid_argument& e) {
    archive.Fail(e.what());
  }
}

}  // namespace dfr::imitation
