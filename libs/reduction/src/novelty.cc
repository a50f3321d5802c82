#include "dfr/reduction/novelty.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/numerics/linear_algebra.h"

namespace dfr::reduction {
namespace {

constexpr int kWindowSide = 3;
constexpr std::size_t kMostFolds = 5;
// Fraction of the demonstrations that may exceed a limit without its margin.
constexpr double kBeyond = 0.05;
constexpr double kMostValue = 1e9;
// A smaller variance of a window is invalid: kFloor^2 is added to all variances.
constexpr double kLeastVariance = 1.0;

int WindowRows(const core::PictureShape& shape) noexcept {
  return std::max(1, shape.height - kWindowSide + 1);
}

int WindowColumns(const core::PictureShape& shape) noexcept {
  return std::max(1, shape.width - kWindowSide + 1);
}

// Calls `use(i, mean)` with the mean of `values` over each window. `values` has one entry per
// pixel.
template <typename Values, typename Use>
void ForEachWindow(const core::PictureShape& shape, const Values& values, const Use& use) noexcept {
  const int high = std::min(kWindowSide, shape.height);
  const int wide = std::min(kWindowSide, shape.width);
  const int columns = WindowColumns(shape);
  using Value = typename Values::Scalar;
  const Value share = Value{1} / static_cast<Value>(high * wide);
  for (int row = 0; row < WindowRows(shape); ++row) {
    for (int column = 0; column < columns; ++column) {
      Value sum{0};
      for (int y = 0; y < high; ++y) {
        const Eigen::Index from = Eigen::Index{row + y} * shape.width + column;
        for (int x = 0; x < wide; ++x) sum += values[from + x];
      }
      use(Eigen::Index{row} * columns + column, share * sum);
    }
  }
}

// Adds to each pixel's variance the squared change of the mean picture for a camera shift of one
// pixel, averaged over channels. This change is the larger of the two changes along the row, plus
// the larger of the two along the column.
void AddShift(const core::PictureShape& shape, const Eigen::VectorXd& mean,
              Eigen::VectorXd& variance) {
  const auto change = [&](Eigen::Index pixel, Eigen::Index other) {
    return (mean.segment(pixel * shape.channels, shape.channels) -
            mean.segment(other * shape.channels, shape.channels))
               .squaredNorm() /
           shape.channels;
  };
  for (int row = 0; row < shape.height; ++row) {
    for (int column = 0; column < shape.width; ++column) {
      const Eigen::Index pixel = Eigen::Index{row} * shape.width + column;
      double along = 0.0;
      double down = 0.0;
      if (column > 0) along = change(pixel, pixel - 1);
      if (column + 1 < shape.width) along = std::max(along, change(pixel, pixel + 1));
      if (row > 0) down = change(pixel, pixel - shape.width);
      if (row + 1 < shape.height) down = std::max(down, change(pixel, pixel + shape.width));
      variance[pixel] += along + down;
    }
  }
}

// Sums over pictures and over the positions of their patches.
struct Moments {
  double rows = 0.0;
  Eigen::VectorXd sum;
  Eigen::VectorXd squares;
  Eigen::VectorXd positions;
  Eigen::MatrixXd products;

  Moments(Eigen::Index entries, Eigen::Index places)
      : sum(Eigen::VectorXd::Zero(entries)),
        squares(sum),
        positions(Eigen::VectorXd::Zero(places)),
        products(Eigen::MatrixXd::Zero(places, places)) {}
  void Add(const Moments& other) {
    rows += other.rows;
    sum += other.sum;
    squares += other.squares;
    positions += other.positions;
    products += other.products;
  }
};

// Returns the smallest limit that at most kBeyond of the values exceed.
double Limit(std::vector<double> values) {
  std::ranges::sort(values, std::greater{});
  return values[static_cast<std::size_t>(kBeyond * static_cast<double>(values.size()))];
}

}  // namespace

Novelty::Workspace::Workspace(const Novelty& novelty)
    : squares_(novelty.mean_.size() / novelty.shape_.channels),
      positions_(novelty.middle_.size()),
      whitened_(novelty.middle_.size()) {}

Novelty::Novelty(const core::PictureShape& shape, Eigen::VectorXd mean, Eigen::VectorXd variance,
                 Eigen::VectorXd middle, core::Matrix whitening)
    : shape_(shape),
      mean_(std::move(mean)),
      variance_(std::move(variance)),
      middle_(std::move(middle)),
      whitening_(std::move(whitening)) {
  const auto within = [](const auto& values) {
    return values.allFinite() && (values.array().abs() <= kMostValue).all();
  };
  DFR_THROW_UNLESS(mean_.size() == Eigen::Index{shape.height} * shape.width * shape.channels &&
                       variance_.size() == Eigen::Index{WindowRows(shape)} * WindowColumns(shape) &&
                       whitening_.rows() == middle_.size() && whitening_.cols() == middle_.size(),
                   "there are " << mean_.size() << " entries of a mean, " << variance_.size()
                                << " variances of windows and " << middle_.size()
                                << " positions of a picture of " << shape.height << " x "
                                << shape.width << " x " << shape.channels);
  DFR_THROW_UNLESS(within(mean_) && within(variance_) && within(middle_) && within(whitening_),
                   "an entry is not finite or not within " << kMostValue);
  DFR_THROW_UNLESS(variance_.minCoeff() >= kLeastVariance,
                   "a window's variance is " << variance_.minCoeff() << ", but must be at least "
                                             << kLeastVariance);
  mean_of_pixels_ = mean_.cast<float>();
  inverse_variance_ = variance_.cwiseInverse().cast<float>();
}

void Novelty::CheckLimits() const {
  for (const double limit : {limit_.picture, limit_.positions}) {
    DFR_THROW_UNLESS(limit > 0.0 && limit <= kMostValue,
                     "a limit must lie in (0, " << kMostValue << "], not " << limit);
  }
  DFR_THROW_UNLESS(left_out_ >= 0.0 && left_out_ <= 1.0,
                   "a share must lie in [0, 1], not " << left_out_);
}

Novelty Novelty::Fit(const RowSource& pictures, const core::PictureShape& shape,
                     std::span<const Eigen::Index> begin, std::span<const core::Matrix> positions) {
  const std::size_t count = begin.size() - std::min<std::size_t>(1, begin.size());
  DFR_THROW_UNLESS(count >= 2, "a limit of novelty needs two demonstrations, not " << count);
  DFR_THROW_UNLESS(
      begin.back() == pictures.rows() && (positions.empty() || positions.size() == count),
      "there are " << pictures.rows() << " pictures and positions of " << positions.size()
                   << " demonstrations, not " << begin.back() << " and " << count);
  const Eigen::Index places = positions.empty() ? 0 : positions[0].cols();
  core::Matrix rows;
  const auto read = [&](std::size_t d) {
    DFR_THROW_UNLESS(begin[d] < begin[d + 1], "demonstration " << d << " has no picture");
    DFR_THROW_UNLESS(positions.empty() || (positions[d].rows() == begin[d + 1] - begin[d] &&
                                           positions[d].cols() == places),
                     "demonstration " << d << " has positions of another size");
    rows.resize(begin[d + 1] - begin[d], pictures.width());
    pictures.Read(begin[d], rows);
  };
  const std::size_t folds = std::min(kMostFolds, count);
  std::vector<Moments> parts(folds, Moments(pictures.width(), places));
  for (std::size_t d = 0; d < count; ++d) {
    read(d);
    Moments& part = parts[d % folds];
    part.rows += static_cast<double>(rows.rows());
    part.sum += rows.colwise().sum().transpose();
    part.squares += rows.colwise().squaredNorm().transpose();
    if (places == 0) continue;
    part.positions += positions[d].colwise().sum().transpose();
    part.products += core::Multiply(positions[d].transpose(), positions[d]);
  }
  const auto fit = [&](std::size_t without) {
    Moments all(pictures.width(), places);
    for (std::size_t f = 0; f < folds; ++f) {
      if (f != without) all.Add(parts[f]);
    }
    const Eigen::VectorXd mean = all.sum / all.rows;
    const Eigen::VectorXd variance = (all.squares / all.rows - mean.cwiseAbs2()).cwiseMax(0.0);
    Eigen::VectorXd of_pixels = variance.reshaped(shape.channels, variance.size() / shape.channels)
                                    .colwise()
                                    .mean()
                                    .transpose();
    AddShift(shape, mean, of_pixels);
    Eigen::VectorXd of_windows(Eigen::Index{WindowRows(shape)} * WindowColumns(shape));
    ForEachWindow(shape, of_pixels,
                  [&](Eigen::Index i, double value) { of_windows[i] = value + kFloor * kFloor; });
    if (places == 0) return Novelty(shape, mean, of_windows, {}, {});
    const Eigen::VectorXd middle = all.positions / all.rows;
    Eigen::MatrixXd covariance = all.products / all.rows - middle * middle.transpose();
    // Positions are in [0, 1]. If they do not vary, a change by kRidge has length 1.
    covariance.diagonal().array() +=
        kRidge * std::max(kRidge, covariance.trace() / static_cast<double>(places));
    const core::SymmetricEigen eigen = core::DecomposeSymmetric(covariance);
    const core::Matrix whitening =
        eigen.values.cwiseMax(kRidge * kRidge * kRidge).cwiseSqrt().cwiseInverse().asDiagonal() *
        eigen.vectors.transpose();
    return Novelty(shape, mean, of_windows, middle, whitening);
  };
  std::vector<double> of_pictures(count);
  std::vector<double> of_positions(count);
  std::vector<float> picture(static_cast<std::size_t>(pictures.width()));
  for (std::size_t f = 0; f < folds; ++f) {
    const Novelty others = fit(f);
    Workspace workspace(others);
    for (std::size_t d = f; d < count; d += folds) {
      read(d);
      for (Eigen::Index i = 0; i < rows.rows(); ++i) {
        std::ranges::transform(core::Row(std::as_const(rows), i), picture.begin(),
                               [](double v) { return static_cast<float>(v); });
        const Statistics found = others.Measure(
            picture, places == 0 ? std::span<const double>() : core::Row(positions[d], i),
            workspace);
        of_pictures[d] = std::max(of_pictures[d], found.picture);
        of_positions[d] = std::max(of_positions[d], found.positions);
      }
    }
  }
  Novelty all = fit(folds);
  // For identical pictures the values are 0, which is not a valid limit.
  all.limit_.picture = kMargin * std::max(1.0, Limit(of_pictures));
  if (places > 0) all.limit_.positions = kMargin * std::max(1.0, Limit(of_positions));
  double beyond = 0.0;
  for (std::size_t d = 0; d < count; ++d) {
    if (of_pictures[d] > all.limit_.picture || of_positions[d] > all.limit_.positions) ++beyond;
  }
  all.left_out_ = beyond / static_cast<double>(count);
  all.CheckLimits();
  return all;
}

Novelty::Statistics Novelty::Measure(std::span<const float> picture,
                                     std::span<const double> positions,
                                     Workspace& workspace) const noexcept {
  Statistics found;
  const float share = 1.0F / static_cast<float>(shape_.channels);
  for (Eigen::Index i = 0, at = 0; i < workspace.squares_.size(); ++i) {
    float sum = 0.0F;
    for (int c = 0; c < shape_.channels; ++c, ++at) {
      const float difference = picture[static_cast<std::size_t>(at)] - mean_of_pixels_[at];
      sum += difference * difference;
    }
    workspace.squares_[i] = share * sum;
  }
  float most = 0.0F;
  ForEachWindow(shape_, workspace.squares_, [&](Eigen::Index i, float value) {
    const float relative = value * inverse_variance_[i];
    if (!(relative <= most) && !std::isnan(most)) most = relative;  // A NaN stays.
  });
  found.picture = static_cast<double>(most);
  if (middle_.size() == 0) return found;
  workspace.positions_ = core::AsVector(positions) - middle_;
  workspace.whitened_.noalias() = whitening_ * workspace.positions_;
  found.positions = workspace.whitened_.squaredNorm() / static_cast<double>(middle_.size());
  return found;
}

double Novelty::Of(std::span<const float> picture, std::span<const double> positions,
                   Workspace& workspace) const noexcept {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  if (std::ssize(picture) != mean_.size() || std::ssize(positions) != middle_.size()) {
    return kInfinity;
  }
  const Statistics found = Measure(picture, positions, workspace);
  const double of_picture = found.picture / limit_.picture;
  const double of_positions = found.positions / limit_.positions;
  if (!std::isfinite(of_picture) || !std::isfinite(of_positions)) return kInfinity;
  return std::max(of_picture, of_positions);
}

void Novelty::Save(core::ArchiveWriter& archive) const {
  archive.Numbers(core::AsSpan(mean_));
  archive.Numbers(core::AsSpan(variance_));
  archive.Numbers(core::AsSpan(middle_));
  archive.MatrixBlock(whitening_);
  for (const double value : {limit_.picture, limit_.positions, left_out_}) archive.Number(value);
}

Novelty Novelty::Load(core::ArchiveReader& archive, const core::PictureShape& shape) {
  const std::vector<double> mean = archive.Numbers();
  const std::vector<double> variance = archive.Numbers();
  const std::vector<double> middle = archive.Numbers();
  core::Matrix whitening = archive.MatrixBlock();
  try {
    Novelty novelty(shape, core::AsVector(mean), core::AsVector(variance), core::AsVector(middle),
                    std::move(whitening));
    novelty.limit_.picture = archive.Number();
    novelty.limit_.positions = archive.Number();
    novelty.left_out_ = archive.Number();
    novelty.CheckLimits();
    return novelty;
  } catch (const std::invalid_argument& e) {
    archive.Fail(std::string("holds no novelty limit: ") + e.what());
  }
}

}  // namespace dfr::reduction
