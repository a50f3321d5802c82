#include "dfr/reduction/state_reduction.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/text/format.h"
#include "state_pictures.h"

namespace dfr::reduction {
namespace {

using internal::kPrefixes;
using internal::ShapeOf;
using internal::ToBytes;
using internal::ViewOf;

constexpr int kMostParts = 1 << 12;
constexpr int kMostPixelsASide = 1 << 13;
// Maximum number of entries of a reduced state, including blocks that are copied whole.
constexpr int kMostReducedEntries = 1 << 12;

// Returns (P P')^-1. P' times this matrix is the pseudo-inverse of P. For principal components,
// whose P is orthonormal, it is the identity.
Eigen::MatrixXd InverseGram(const core::Matrix& p) {
  const Eigen::MatrixXd gram = p * p.transpose();
  return core::SolveSymmetric(gram, Eigen::MatrixXd::Identity(p.rows(), p.rows()));
}

}  // namespace

StateReduction::Workspace::Workspace(const StateReduction& reduction) {
  std::size_t bytes = 0;
  std::size_t floats = 0;
  for (const Part& part : reduction.parts_) {
    if (!part.picture) continue;
    pictures_.push_back(*part.picture);
    novelties_.push_back(part.novelty ? Novelty::Workspace(*part.novelty) : Novelty::Workspace());
    bytes = std::max(bytes, static_cast<std::size_t>(part.size));
    floats = std::max(floats, static_cast<std::size_t>(part.picture->size()));
    if (!part.points) continue;
    points_.emplace_back(*part.points);
    positions_.resize(std::max(positions_.size(), static_cast<std::size_t>(part.points->size())));
  }
  bytes_.resize(bytes);
  floats_.resize(floats);
  state_.resize(static_cast<std::size_t>(reduction.reduced_dim()));
}

StateReduction::StateReduction(core::StateLayout layout, std::vector<Part> parts,
                               std::string features)
    : layout_(std::move(layout)), parts_(std::move(parts)), features_(std::move(features)) {
  for (Part& part : parts_) {
    part.first = reduced_.state_dim();
    reduced_.Add(std::string(kPrefixes[static_cast<std::size_t>(part.kind)]) + part.name,
                 part.reduced_size());
  }
  DFR_THROW_UNLESS(reduced_dim() <= kMostReducedEntries,
                   "the reduced state has " << reduced_dim() << " entries, but at most "
                                            << kMostReducedEntries
                                            << " are supported: put pca: before large blocks");
}

StateReduction StateReduction::WithComponents(int components) const {
  std::vector<Part> parts = parts_;
  for (Part& part : parts) {
    if (!part.open) continue;
    const Reduction& all = *part.reduction;
    part.reduction =
        Reduction(all.mean(), all.scale(),
                  all.projection().topRows(std::clamp(components, 1, all.num_components())));
  }
  return {layout_, std::move(parts), features_};
}

StateReduction StateReduction::Combined(std::span<const core::Matrix> weights) const {
  std::vector<Part> parts = parts_;
  auto next = weights.begin();
  for (Part& part : parts) {
    if (!part.open) continue;
    const Reduction& all = *part.reduction;
    part.reduction = Reduction(all.mean(), all.scale(), *next++ * all.projection());
  }
  return {layout_, std::move(parts), features_};
}

int StateReduction::num_open() const noexcept {
  return static_cast<int>(std::ranges::count(parts_, true, &Part::open));
}

int StateReduction::most_components() const noexcept {
  int most = 0;
  for (const Part& part : parts_) {
    if (part.open) most = std::max(most, part.reduced_size());
  }
  return most;
}

bool StateReduction::sums_open_pixels() const noexcept {
  return std::ranges::any_of(
      parts_, [](const Part& part) { return part.open && part.picture && !part.points; });
}

std::vector<int> StateReduction::InOrderOfComponents() const {
  std::vector<int> columns;
  columns.reserve(static_cast<std::size_t>(reduced_dim()));
  for (const Part& part : parts_) {
    for (int i = 0; i < part.reduced_size() && !part.open; ++i) columns.push_back(part.first + i);
  }
  for (int i = 0; i < most_components(); ++i) {
    for (const Part& part : parts_) {
      if (part.open && i < part.reduced_size()) columns.push_back(part.first + i);
    }
  }
  return columns;
}

std::vector<std::vector<int>> StateReduction::PositionsInOrder() const {
  const std::vector<int> order = InOrderOfComponents();
  std::vector<std::vector<int>> positions;
  for (const Part& part : parts_) {
    if (!part.open) continue;
    std::vector<int>& own = positions.emplace_back();
    for (int i = 0; i < part.reduced_size(); ++i) {
      own.push_back(static_cast<int>(std::ranges::find(order, part.first + i) - order.begin()));
    }
  }
  return positions;
}

// Uses `points` and `positions` if the part has points, and `novelty` if it has a novelty.
double StateReduction::ReducePicture(const Part& part, std::span<const float> picture,
                                     FeaturePoints::Workspace* points, std::span<double> positions,
                                     Novelty::Workspace& novelty, std::span<double> out) noexcept {
  positions = positions.first(part.points ? static_cast<std::size_t>(part.points->size()) : 0);
  if (part.points) {
    part.points->Apply(picture, *points, positions);
    part.reduction->Apply(std::span<const double>(positions), out);
  } else {
    part.reduction->Apply(picture, out);
  }
  return part.novelty ? part.novelty->Of(picture, positions, novelty) : 0.0;
}

bool StateReduction::Apply(std::span<const double> state, Workspace& workspace) const noexcept {
  bool good = static_cast<int>(state.size()) == state_dim();
  workspace.novelty_ = 0.0;
  std::size_t next_picture = 0;
  std::size_t next_points = 0;
  for (const Part& part : parts_) {
    if (!good) break;
    const auto in =
        state.subspan(static_cast<std::size_t>(part.offset), static_cast<std::size_t>(part.size));
    const auto out = std::span(workspace.state_)
                         .subspan(static_cast<std::size_t>(part.first),
                                  static_cast<std::size_t>(part.reduced_size()));
    if (part.picture) {
      Novelty::Workspace& novelty = workspace.novelties_[next_picture];
      ImageFeatures& picture = workspace.pictures_[next_picture++];
      const auto floats =
          std::span(workspace.floats_).first(static_cast<std::size_t>(picture.size()));
      good = ToBytes(in, workspace.bytes_) &&
             picture.Apply(ViewOf(picture, workspace.bytes_), floats) == PictureFault::kNone;
      FeaturePoints::Workspace* const points =
          part.points ? &workspace.points_[next_points++] : nullptr;
      if (good) {
        workspace.novelty_ =
            std::max(workspace.novelty_,
                     ReducePicture(part, floats, points, workspace.positions_, novelty, out));
      }
    } else if (part.reduction) {
      part.reduction->Apply(in, out);
    } else {
      std::copy(in.begin(), in.end(), out.begin());
    }
    good = good && core::AllFinite(out);
  }
  if (!good) {
    std::ranges::fill(workspace.state_, std::numeric_limits<double>::quiet_NaN());
    workspace.novelty_ = 0.0;
  }
  return good;
}

std::string StateReduction::Fault(std::span<const double> state) const {
  if (static_cast<int>(state.size()) != state_dim()) {
    return core::Format("the state has %zu entries, not %d", state.size(), state_dim());
  }
  Workspace workspace(*this);
  std::size_t next_picture = 0;
  std::size_t next_points = 0;
  std::string strange;  // Reported if there is no other fault.
  for (const Part& part : parts_) {
    const auto in =
        state.subspan(static_cast<std::size_t>(part.offset), static_cast<std::size_t>(part.size));
    const auto bad = std::ranges::find_if(in, [&](double v) {
      return !std::isfinite(v) || (part.picture && !(v >= 0.0 && v <= 255.0));
    });
    if (bad != in.end()) {
      return part.name + core::Format("[%td] of the state is %g", bad - in.begin(), *bad) +
             (std::isfinite(*bad) ? "; a picture has values from 0 to 255" : "");
    }
    if (!part.picture) continue;
    Novelty::Workspace& novelty = workspace.novelties_[next_picture];
    ImageFeatures& picture = workspace.pictures_[next_picture++];
    FeaturePoints::Workspace* const points =
        part.points ? &workspace.points_[next_points++] : nullptr;
    const auto floats =
        std::span(workspace.floats_).first(static_cast<std::size_t>(picture.size()));
    static_cast<void>(ToBytes(in, workspace.bytes_));
    if (picture.Apply(ViewOf(picture, workspace.bytes_), floats) == PictureFault::kDark) {
      return "the picture '" + part.name + "' is black";
    }
    const double relative =
        ReducePicture(part, floats, points, workspace.positions_, novelty,
                      std::span(workspace.state_)
                          .subspan(static_cast<std::size_t>(part.first),
                                   static_cast<std::size_t>(part.reduced_size())));
    if (relative > 1.0 && strange.empty()) {
      strange = core::Format(
          "the picture '%s' resembles no demonstration: its difference from all of them is %.3g "
          "times the limit; remove what no demonstration shows, or add demonstrations that show it",
          part.name.c_str(), relative);
    }
  }
  return strange;
}

void StateReduction::Spread(const Eigen::MatrixXd& products, std::span<const double> state,
                            std::span<double> shares) const {
  std::ranges::fill(shares, 0.0);
  Workspace workspace(*this);
  if (!Apply(state, workspace)) return;
  std::size_t next_points = 0;
  for (const Part& part : parts_) {
    const Eigen::Index k = part.reduced_size();
    const auto own = products.block(part.first, part.first, k, k);
    const auto out =
        shares.subspan(static_cast<std::size_t>(part.offset), static_cast<std::size_t>(part.size));
    if (!part.reduction) {
      core::AsVector(out) = own.diagonal();
      continue;
    }
    const core::Matrix& p = part.reduction->projection();
    const core::Matrix spread = own * InverseGram(p) * p;
    const Eigen::VectorXd share = spread.cwiseProduct(p).colwise().sum().transpose();
    if (part.points) {
      // Adds the shares of column and row of each point.
      const Eigen::VectorXd of_points =
          share.reshaped(2, part.points->num_points()).colwise().sum().transpose();
      std::vector<double> pixels(static_cast<std::size_t>(part.picture->size()));
      part.points->Spread(core::AsSpan(of_points), workspace.points_[next_points++], pixels);
      part.picture->Spread(pixels, out);
    } else if (part.picture) {
      part.picture->Spread(core::AsSpan(share), out);
    } else {
      core::AsVector(out) = share;
    }
  }
}

StateReduction::Seen StateReduction::Reconstruct(std::string_view block,
                                                 std::span<const double> state) const {
  Workspace workspace(*this);
  DFR_THROW_UNLESS(Apply(state, workspace), Fault(state));
  for (const Part& part : parts_) {
    if (part.name != block || !part.reduction) continue;
    DFR_THROW_UNLESS(!part.points, "the block '"
                                       << block
                                       << "' is reduced to positions of patches, which "
                                          "cannot be shown as a picture; use pca: or slow:");
    Seen seen;
    if (part.picture) seen.shape = ShapeOf(*part.picture);
    const Reduction& reduction = *part.reduction;
    const auto z = core::AsVector(workspace.state()).segment(part.first, part.reduced_size());
    const core::Matrix& p = reduction.projection();
    const Eigen::VectorXd standardised = p.transpose() * (InverseGram(p) * z);
    const Eigen::VectorXd values = reduction.mean() + reduction.scale().cwiseProduct(standardised);
    seen.values.assign(values.begin(), values.end());
    return seen;
  }
  DFR_THROW_UNLESS(false,
                   "there is no reduced block '" << block << "'; the features are " << features_);
}

std::optional<double> StateReduction::novel_left_out() const noexcept {
  std::optional<double> most;
  for (const Part& part : parts_) {
    if (part.novelty) most = std::max(most.value_or(0.0), part.novelty->left_out());
  }
  return most;
}

void StateReduction::Save(core::ArchiveWriter& archive) const {
  archive.Text(features_);
  archive.Integer(std::ssize(parts_));
  for (const Part& part : parts_) {
    archive.Text(part.name);
    archive.Integer(part.open ? 1 : 0);
    archive.Integer(static_cast<int>(part.kind));
    if (!part.reduction) continue;
    if (part.picture) {
      const ImageFeaturesOptions& o = part.picture->options();
      for (const int value : {o.out_height, o.out_width, o.grey ? 1 : 0, static_cast<int>(o.light)})
        archive.Integer(value);
    }
    if (part.points) part.points->Save(archive);
    part.reduction->Save(archive);
    if (!part.picture) continue;
    archive.Integer(part.novelty ? 1 : 0);
    if (part.novelty) part.novelty->Save(archive);
  }
}

StateReduction StateReduction::Load(core::ArchiveReader& archive, const core::StateLayout& layout) {
  std::string features = archive.Text();
  std::vector<Part> parts;
  const int count = archive.IntegerIn(1, kMostParts);
  try {
    for (int i = 0; i < count; ++i) {
      Part part{.name = archive.Text()};
      const auto block =
          std::ranges::find(layout.blocks, part.name, &core::StateLayout::Block::name);
      if (block == layout.blocks.end()) archive.Fail("reduces a block that is not in the state");
      part.offset = block->offset;
      part.size = block->size;
      part.open = archive.IntegerIn(0, 1) == 1;
      part.kind = static_cast<Kind>(archive.IntegerIn(0, static_cast<int>(Kind::kSlow)));
      const bool reduced = part.kind != Kind::kCopied;
      if (part.open && !reduced)
        archive.Fail("leaves the number of components of a copied block open");
      if (reduced) {
        if (block->picture.height > 0) {
          ImageFeaturesOptions o{.width = block->picture.width,
                                 .height = block->picture.height,
                                 .channels = block->picture.channels};
          o.out_height = archive.IntegerIn(1, kMostPixelsASide);
          o.out_width = archive.IntegerIn(1, kMostPixelsASide);
          o.grey = archive.IntegerIn(0, 1) == 1;
          o.light = static_cast<LightNormalisation>(
              archive.IntegerIn(0, static_cast<int>(LightNormalisation::kGainAndOffset)));
          part.picture.emplace(o);
        }
        int width = part.picture ? part.picture->size() : part.size;
        if (part.kind == Kind::kPoints) {
          if (!part.picture) archive.Fail("has points of a block that is not a picture");
          part.points = FeaturePoints::Load(archive, ShapeOf(*part.picture));
          width = part.points->size();
        }
        part.reduction = Reduction::Load(archive);
        if (part.reduction->input_dim() != width) {
          archive.Fail("has a reduction for a different number of entries");
        }
        if (part.picture && archive.IntegerIn(0, 1) == 1) {
          part.novelty = Novelty::Load(archive, ShapeOf(*part.picture));
          if (part.novelty->num_positions() != (part.points ? part.points->size() : 0)) {
            archive.Fail("has a novelty limit for a different number of positions");
          }
        }
      }
      parts.push_back(std::move(part));
    }
    return {layout, std::move(parts), std::move(features)};
  } catch (const std::invalid_argument& e) {
    archive.Fail(std::string("holds no state reduction: ") + e.what());
  }
}

}  // namespace dfr::reduction
