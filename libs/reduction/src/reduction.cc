#include "dfr/reduction/reduction.h"

#include <algorithm>
#include <array>
#include <limits>
#include <stdexcept>
#include <utility>

#include "dfr/core/contract.h"

namespace dfr::reduction {
namespace {

// Number of entries summed in float. Their centred values are on the stack.
constexpr Eigen::Index kChunk = 512;

}  // namespace

Reduction::Reduction(Eigen::VectorXd mean, Eigen::VectorXd scale, core::Matrix projection)
    : mean_(std::move(mean)), scale_(std::move(scale)), projection_(std::move(projection)) {
  const Eigen::Index d = mean_.size();
  DFR_THROW_UNLESS(d >= 1 && d <= kMaxInputs,
                   "a reduction takes 1 to " << kMaxInputs << " entries, not " << d);
  DFR_THROW_UNLESS(scale_.size() == d && projection_.cols() == d,
                   "mean, scale and projection have " << d << ", " << scale_.size() << " and "
                                                      << projection_.cols() << " entries");
  DFR_THROW_UNLESS(
      projection_.rows() >= 1 && projection_.rows() <= kMaxComponents,
      "a reduction has 1 to " << kMaxComponents << " components, not " << projection_.rows());
  DFR_THROW_UNLESS(mean_.allFinite() && scale_.allFinite() && projection_.allFinite(),
                   "mean, scale and projection must be finite");
  DFR_THROW_UNLESS(scale_.minCoeff() >= 0.0, "a scale is negative: " << scale_.minCoeff());
  const Eigen::VectorXd inverse = (scale_.array() > 0.0).select(scale_.cwiseInverse(), 0.0);
  weights_ = (projection_ * inverse.asDiagonal()).cast<float>();
  DFR_THROW_UNLESS(weights_.allFinite(),
                   "a scale is too small for single precision: "
                       << (scale_.array() > 0.0)
                              .select(scale_, std::numeric_limits<double>::infinity())
                              .minCoeff());
}

Reduction Reduction::Principal(const PrincipalComponents& fit, int components) {
  DFR_THROW_UNLESS(
      components >= 1 && components <= fit.components.rows(),
      "there are " << fit.components.rows() << " principal components, not " << components);
  return {fit.mean, fit.scale, fit.components.topRows(components)};
}

template <typename Value>
void Reduction::Project(std::span<const Value> x, std::span<double> z) const noexcept {
  core::AsVector(z).setZero();
  if (std::ssize(x) != mean_.size() || std::ssize(z) != projection_.rows()) {
    std::fill(z.begin(), z.end(), std::numeric_limits<double>::quiet_NaN());
    return;
  }
  alignas(64) std::array<float, kChunk> centred;
  alignas(64) std::array<float, kMaxComponents> sums;
  Eigen::Map<Eigen::VectorXf> sum(sums.data(), projection_.rows());
  for (Eigen::Index first = 0; first < mean_.size(); first += kChunk) {
    const Eigen::Index count = std::min(kChunk, mean_.size() - first);
    const Eigen::Map<const Eigen::Matrix<Value, Eigen::Dynamic, 1>> chunk(x.data() + first, count);
    Eigen::Map<Eigen::VectorXf> centred_chunk(centred.data(), count);
    centred_chunk =
        (chunk.template cast<double>() - mean_.segment(first, count)).template cast<float>();
    sum.noalias() = weights_.middleCols(first, count) * centred_chunk;
    core::AsVector(z) += sum.cast<double>();
  }
}

void Reduction::Apply(std::span<const double> x, std::span<double> z) const noexcept {
  Project(x, z);
}
void Reduction::Apply(std::span<const float> x, std::span<double> z) const noexcept {
  Project(x, z);
}

void Reduction::Save(core::ArchiveWriter& archive) const {
  archive.Numbers(core::AsSpan(mean_));
  archive.Numbers(core::AsSpan(scale_));
  archive.MatrixBlock(projection_);
}

Reduction Reduction::Load(core::ArchiveReader& archive) {
  const std::vector<double> mean = archive.Numbers();
  const std::vector<double> scale = archive.Numbers();
  core::Matrix projection = archive.MatrixBlock();
  try {
    return {core::AsVector(mean), core::AsVector(scale), std::move(projection)};
  } catch (const std::invalid_argument& e) {
    archive.Fail(std::string("holds no reduction: ") + e.what());
  }
}

}  // namespace dfr::reduction
