#include "dfr/reduction/feature_points.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <utility>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "dfr/reduction/image_features.h"

namespace dfr::reduction {
namespace {

// The squares of values up to this limit can be summed in single precision.
constexpr double kLargestEntry = 1e6;
// Number of pictures read at once.
constexpr Eigen::Index kPicturesAtOnce = 256;
// A window has a single colour if its variance is below this fraction of the picture's variance.
constexpr double kFlat = 1e-9;

// One window of one picture.
struct Draw {
  Eigen::Index picture = 0;
  Eigen::Index row = 0;
  Eigen::Index column = 0;
};

// Returns random windows, one per row, in units of the standard deviation.
core::Matrix DrawWindows(const RowSource& pictures, const core::PictureShape& shape,
                         const FeaturePointsOptions& options, core::Random& random) {
  const auto below = [&](Eigen::Index count) {
    return static_cast<Eigen::Index>(random.Below(static_cast<std::uint64_t>(count)));
  };
  const auto all = static_cast<double>(pictures.rows()) * (shape.height - options.side + 1) *
                   (shape.width - options.side + 1);
  std::vector<Draw> draws(static_cast<std::size_t>(std::min<double>(options.samples, all)));
  for (Draw& draw : draws) {
    draw.picture = below(pictures.rows());
    draw.row = below(shape.height - options.side + 1);
    draw.column = below(shape.width - options.side + 1);
  }
  std::ranges::stable_sort(draws, {}, &Draw::picture);
  const Eigen::Index line = static_cast<Eigen::Index>(options.side) * shape.channels;
  core::Matrix windows(std::ssize(draws), options.side * line);
  core::Matrix block;
  Eigen::Index first = 0;
  for (std::size_t i = 0; i < draws.size(); ++i) {
    const Draw& draw = draws[i];
    if (i == 0 || draw.picture >= first + block.rows()) {
      first = draw.picture;
      block.resize(std::min(kPicturesAtOnce, pictures.rows() - first), pictures.width());
      pictures.Read(first, block);
    }
    for (int y = 0; y < options.side; ++y) {
      const Eigen::Index from = ((draw.row + y) * shape.width + draw.column) * shape.channels;
      windows.block(static_cast<Eigen::Index>(i), y * line, 1, line) =
          block.block(draw.picture - first, from, 1, line);
    }
  }
  DFR_THROW_UNLESS(windows.allFinite(), "a picture has an entry that is not finite");
  return (windows.array() - kNormalMean) / kNormalDeviation;
}

// Returns the windows whose variance is above the median.
core::Matrix Detailed(const core::Matrix& windows) {
  const Eigen::VectorXd mean = windows.rowwise().mean();
  const Eigen::VectorXd variance =
      (windows.colwise() - mean).rowwise().squaredNorm() / static_cast<double>(windows.cols());
  std::vector<Eigen::Index> order(static_cast<std::size_t>(windows.rows()));
  std::iota(order.begin(), order.end(), Eigen::Index{0});
  std::ranges::stable_sort(order, std::ranges::greater{},
                           [&](Eigen::Index i) { return variance[i]; });
  DFR_THROW_UNLESS(variance[order[0]] > kFlat, "all pictures have a single colour");
  order.resize((order.size() + 1) / 2);
  std::ranges::sort(order);
  return windows(order, Eigen::all);
}

core::Matrix KMeans(const core::Matrix& samples, const FeaturePointsOptions& options,
                    core::Random& random) {
  const Eigen::MatrixXf points = samples.transpose().cast<float>();
  core::Matrix centres(options.points, samples.cols());
  std::vector<Eigen::Index> order(static_cast<std::size_t>(samples.rows()));
  std::iota(order.begin(), order.end(), Eigen::Index{0});
  random.Shuffle(std::span(order));
  for (Eigen::Index k = 0; k < centres.rows(); ++k) {
    centres.row(k) = samples.row(order[static_cast<std::size_t>(k) % order.size()]);
  }
  std::vector<Eigen::Index> nearest(order.size(), -1);
  Eigen::MatrixXf costs;
  for (int i = 0; i < options.iterations; ++i) {
    const Eigen::MatrixXf weights = (-2.0 * centres).cast<float>();
    const Eigen::VectorXf norms = centres.rowwise().squaredNorm().cast<float>();
    costs.noalias() = weights * points;
    costs.colwise() += norms;
    core::Matrix sums = core::Matrix::Zero(centres.rows(), centres.cols());
    Eigen::VectorXd counts = Eigen::VectorXd::Zero(centres.rows());
    bool moved = false;
    for (Eigen::Index n = 0; n < samples.rows(); ++n) {
      Eigen::Index own = 0;
      costs.col(n).minCoeff(&own);
      moved = moved || own != nearest[static_cast<std::size_t>(n)];
      nearest[static_cast<std::size_t>(n)] = own;
      sums.row(own) += samples.row(n);
      counts[own] += 1.0;
    }
    if (!moved) break;
    for (Eigen::Index k = 0; k < centres.rows(); ++k) {
      if (counts[k] > 0.0) centres.row(k) = sums.row(k) / counts[k];
    }
  }
  return centres;
}

// Returns the position of window i of `count`, in [0, 1].
float Place(Eigen::Index i, Eigen::Index count) noexcept {
  return count > 1 ? static_cast<float>(i) / static_cast<float>(count - 1) : 0.0F;
}

}  // namespace

FeaturePoints::Workspace::Workspace(const FeaturePoints& points)
    : picture_(static_cast<Eigen::Index>(points.shape_.height) * points.shape_.width *
               points.shape_.channels),
      windows_(points.patches_.cols(), points.columns()),
      logits_(points.patches_.rows(), points.rows() * points.columns()) {}

void FeaturePoints::CheckShape(const core::PictureShape& shape, int side) {
  DFR_THROW_UNLESS(shape.channels == 1 || shape.channels == 3,
                   "channels must be 1 or 3, not " << shape.channels);
  DFR_THROW_UNLESS(shape.height >= side && shape.width >= side &&
                       shape.height <= kMostPixelsASide && shape.width <= kMostPixelsASide,
                   "feature points need pictures of " << side << " to " << kMostPixelsASide
                                                      << " pixels a side, not " << shape.height
                                                      << " x " << shape.width);
}

FeaturePoints::FeaturePoints(const core::PictureShape& shape, int side, double sharpness,
                             core::Matrix patches)
    : shape_(shape), side_(side), sharpness_(sharpness), patches_(std::move(patches)) {
  DFR_THROW_UNLESS(side >= 1 && side <= kMostSide,
                   "the side of a patch must lie in [1, " << kMostSide << "], not " << side);
  CheckShape(shape, side);
  DFR_THROW_UNLESS(
      patches_.rows() >= 1 && patches_.rows() <= kMostPoints,
      "the number of points must lie in [1, " << kMostPoints << "], not " << patches_.rows());
  DFR_THROW_UNLESS(patches_.cols() == Eigen::Index{side} * side * shape.channels,
                   "patches have " << patches_.cols() << " entries, not " << side << " x " << side
                                   << " x " << shape.channels);
  DFR_THROW_UNLESS(sharpness > 0.0 && sharpness <= kLargestEntry,
                   "sharpness must lie in (0, " << kLargestEntry << "], not " << sharpness);
  DFR_THROW_UNLESS(patches_.allFinite() && patches_.cwiseAbs().maxCoeff() <= kLargestEntry,
                   "patches must be finite and within " << kLargestEntry);
  const double factor = sharpness / static_cast<double>(patches_.cols());
  factor_ = static_cast<float>(factor);
  weights_ = (2.0 * factor * patches_).cast<float>();
  offset_ = (-factor * patches_.rowwise().squaredNorm()).cast<float>();
}

FeaturePoints FeaturePoints::Fit(const RowSource& pictures, const core::PictureShape& shape,
                                 const FeaturePointsOptions& options) {
  DFR_THROW_UNLESS(options.points >= 1 && options.points <= kMostPoints &&
                       options.samples >= options.points && options.iterations >= 1,
                   "points must lie in [1, " << kMostPoints
                                             << "], samples must be at least points, and "
                                                "iterations at least 1, not "
                                             << options.points << ", " << options.samples << " and "
                                             << options.iterations);
  // Checks the shape and the options before the fit uses them.
  const FeaturePoints blank(shape, options.side, options.sharpness,
                            core::Matrix::Zero(options.points, Eigen::Index{options.side} *
                                                                   options.side * shape.channels));
  DFR_THROW_UNLESS(pictures.rows() >= 1 && pictures.width() == Eigen::Index{shape.height} *
                                                                   shape.width * shape.channels,
                   "pictures have " << pictures.width() << " entries, not " << shape.height << " x "
                                    << shape.width << " x " << shape.channels);
  core::Random random(options.seed);
  const core::Matrix samples = Detailed(DrawWindows(pictures, shape, options, random));
  return {shape, options.side, options.sharpness, KMeans(samples, options, random)};
}

void FeaturePoints::Apply(std::span<const float> picture, Workspace& workspace,
                          std::span<double> positions) const noexcept {
  std::ranges::fill(positions, std::numeric_limits<double>::quiet_NaN());
  if (std::ssize(picture) != workspace.picture_.size() || std::ssize(positions) != size()) return;
  const Eigen::Map<const Eigen::VectorXf> in(picture.data(), std::ssize(picture));
  workspace.picture_ =
      (in.array() - static_cast<float>(kNormalMean)) / static_cast<float>(kNormalDeviation);
  // The softmax could hide a NaN.
  if (!std::isfinite(workspace.picture_.squaredNorm())) return;
  const Eigen::Index line = Eigen::Index{side_} * shape_.channels;
  const Eigen::Index columns = this->columns();
  for (Eigen::Index row = 0; row < rows(); ++row) {
    for (int y = 0; y < side_; ++y) {
      const float* from = workspace.picture_.data() + (row + y) * shape_.width * shape_.channels;
      float* to = workspace.windows_.data() + y * line;
      for (Eigen::Index column = 0; column < columns; ++column) {
        std::copy_n(from, line, to);
        from += shape_.channels;
        to += workspace.windows_.rows();
      }
    }
    auto logits = workspace.logits_.middleCols(row * columns, columns);
    logits.noalias() = weights_ * workspace.windows_;
    for (Eigen::Index column = 0; column < columns; ++column) {
      logits.col(column) += offset_;
      logits.col(column).array() -= factor_ * workspace.windows_.col(column).squaredNorm();
    }
  }
  using Sums = std::array<float, kMostPoints>;
  alignas(64) Sums most_memory;
  alignas(64) Sums line_memory;
  alignas(64) Sums total_memory;
  alignas(64) Sums across_memory;
  alignas(64) Sums down_memory;
  const Eigen::Index n = num_points();
  Eigen::Map<Eigen::ArrayXf> most(most_memory.data(), n);
  Eigen::Map<Eigen::ArrayXf> of_line(line_memory.data(), n);
  Eigen::Map<Eigen::ArrayXf> total(total_memory.data(), n);
  Eigen::Map<Eigen::ArrayXf> across(across_memory.data(), n);
  Eigen::Map<Eigen::ArrayXf> down(down_memory.data(), n);
  auto logits = workspace.logits_.array();
  most = logits.col(0);
  for (Eigen::Index i = 1; i < logits.cols(); ++i) most = most.max(logits.col(i));
  total.setZero();
  across.setZero();
  down.setZero();
  for (Eigen::Index row = 0; row < rows(); ++row) {
    of_line.setZero();
    for (Eigen::Index column = 0; column < columns; ++column) {
      auto weight = logits.col(row * columns + column);
      weight = (weight - most).exp();
      of_line += weight;
      across += Place(column, columns) * weight;
    }
    total += of_line;
    down += Place(row, rows()) * of_line;
  }
  for (Eigen::Index k = 0; k < n; ++k) {
    const auto i = static_cast<std::size_t>(2 * k);
    positions[i] = static_cast<double>(across[k] / total[k]);
    positions[i + 1] = static_cast<double>(down[k] / total[k]);
  }
}

void FeaturePoints::Spread(std::span<const double> values, const Workspace& workspace,
                           std::span<double> pixels) const {
  const Eigen::Index line = Eigen::Index{side_} * shape_.channels;
  const Eigen::Map<const Eigen::VectorXd> value(values.data(), num_points());
  Eigen::VectorXd total = Eigen::VectorXd::Zero(num_points());
  for (Eigen::Index i = 0; i < workspace.logits_.cols(); ++i) {
    total += workspace.logits_.col(i).cast<double>();
  }
  const Eigen::VectorXd share = value.cwiseQuotient(total) / static_cast<double>(patches_.cols());
  for (Eigen::Index row = 0; row < rows(); ++row) {
    for (Eigen::Index column = 0; column < columns(); ++column) {
      const double each = share.dot(workspace.logits_.col(row * columns() + column).cast<double>());
      for (int y = 0; y < side_; ++y) {
        double* const to = pixels.data() + ((row + y) * shape_.width + column) * shape_.channels;
        for (Eigen::Index i = 0; i < line; ++i) to[i] += each;
      }
    }
  }
}

void FeaturePoints::Save(core::ArchiveWriter& archive) const {
  archive.Integer(side_);
  archive.Number(sharpness_);
  archive.MatrixBlock(patches_);
}

FeaturePoints FeaturePoints::Load(core::ArchiveReader& archive, const core::PictureShape& shape) {
  const int side = archive.IntegerIn(1, kMostSide);
  const double sharpness = archive.Number();
  core::Matrix patches = archive.MatrixBlock();
  try {
    return {shape, side, sharpness, std::move(patches)};
  } catch (const std::invalid_argument& e) {
    archive.Fail(std::string("holds no feature points: ") + e.what());
  }
}

}  // namespace dfr::reduction
