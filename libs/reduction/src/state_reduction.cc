#include "dfr/reduction/state_reduction.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/format.h"
#include "dfr/core/linear_algebra.h"
#include "dfr/core/numbers.h"
#include "dfr/core/workers.h"
#include "dfr/reduction/principal_components.h"
#include "dfr/reduction/slow_features.h"

namespace dfr::reduction {
namespace {

// By StateReduction::Kind.
constexpr std::array<std::string_view, 4> kPrefixes = {"", "pca:", "points:", "slow:"};
// Pixels along the longer side of a picture of points, unless a size is given.
constexpr int kSideOfPoints = 32;
constexpr int kMostParts = 1 << 12;
constexpr int kMostPixelsASide = 1 << 13;
// What a guard's features may have, and blocks beside them that are copied whole.
constexpr int kMostReducedEntries = 1 << 12;

// Takes the text before the first `separator` off the front.
std::string_view Next(std::string_view& text, char separator) {
  const std::size_t end = text.find(separator);
  const std::string_view item = text.substr(0, end);
  text.remove_prefix(end == std::string_view::npos ? text.size() : end + 1);
  return item;
}

// "32x24", height first.
std::optional<std::pair<int, int>> ParseSize(std::string_view text) {
  const std::string_view height = Next(text, 'x');
  const auto rows = core::ParseInteger<int>(height);
  const auto columns = core::ParseInteger<int>(text);
  if (!rows || !columns) return std::nullopt;
  return std::pair(*rows, *columns);
}

std::optional<LightNormalisation> ParseLight(std::string_view text) {
  if (text == "light=none") return LightNormalisation::kNone;
  if (text == "light=gain") return LightNormalisation::kGain;
  if (text == "light=standard") return LightNormalisation::kGainAndOffset;
  return std::nullopt;
}

// One reduced block of a list of features.
struct Asked {
  std::string name;
  int components = 0;  // 0: left open.
  std::optional<ImageFeaturesOptions> picture = {};
};

Asked ParseAsked(const core::StateLayout& layout, std::string_view item, bool points) {
  std::string_view rest = item.substr(core::ReductionPrefix(item).size());
  Asked asked{.name = std::string(Next(rest, ':'))};
  const auto block = std::ranges::find(layout.blocks, asked.name, &core::StateLayout::Block::name);
  if (block == layout.blocks.end()) {
    std::string names;
    for (const auto& b : layout.blocks) names += (names.empty() ? "" : ", ") + b.name;
    DFR_THROW_UNLESS(false, "feature '" << item << "': there is no block '" << asked.name
                                        << "' in the state; it has " << names);
  }
  const core::PictureShape& shape = block->picture;
  if (shape.height > 0) {
    asked.picture = ImageFeaturesOptions{
        .width = shape.width, .height = shape.height, .channels = shape.channels};
    asked.picture->light = LightNormalisation::kGainAndOffset;
    const int longer = std::max(shape.height, shape.width);
    if (points && longer > kSideOfPoints) {
      asked.picture->out_height = std::max(1, shape.height * kSideOfPoints / longer);
      asked.picture->out_width = std::max(1, shape.width * kSideOfPoints / longer);
    }
  }
  DFR_THROW_UNLESS(asked.picture || !points,
                   "feature '" << item
                               << "': points are for pictures; give the block the shape "
                                  "(height, width, channels) in the layout, or put pca: "
                                  "before it");
  while (!rest.empty()) {
    const std::string_view option = Next(rest, ':');
    if (const auto components = core::ParseInteger<int>(option)) {
      DFR_THROW_UNLESS(*components >= 1 && *components <= Reduction::kMaxComponents,
                       "feature '" << item << "': the number of components must lie in [1, "
                                   << Reduction::kMaxComponents << "]");
      asked.components = *components;
      continue;
    }
    const auto size = ParseSize(option);
    const auto light = ParseLight(option);
    DFR_THROW_UNLESS(size || light || option == "grey",
                     "feature '" << item << "': '" << option
                                 << "' is no option; they are a number of components, grey, a size "
                                    "such as 32x32, and light=none, light=gain or light=standard");
    DFR_THROW_UNLESS(asked.picture, "feature '" << item << "': '" << option
                                                << "' is for pictures; give the block the shape "
                                                   "(height, width, channels) in the layout");
    if (size) std::tie(asked.picture->out_height, asked.picture->out_width) = *size;
    if (light) asked.picture->light = *light;
    if (option == "grey") asked.picture->grey = true;
  }
  return asked;
}

bool AllFinite(std::span<const double> values) noexcept {
  return std::ranges::all_of(values, [](double v) { return std::isfinite(v); });
}

PictureView ViewOf(const ImageFeatures& picture, const std::vector<std::uint8_t>& bytes) noexcept {
  const ImageFeaturesOptions& o = picture.options();
  return {bytes.data(), o.width, o.height, o.channels,
          static_cast<std::size_t>(o.width) * static_cast<std::size_t>(o.channels)};
}

core::PictureShape ShapeOf(const ImageFeatures& picture) noexcept {
  const ImageFeaturesOptions& o = picture.options();
  return {o.out_height, o.out_width, o.grey ? 1 : o.channels};
}

// Multiplies by the inverse of P P', so that P' of the result is the pseudo-inverse. P of principal
// components is orthonormal.
Eigen::MatrixXd InverseGram(const core::Matrix& p) {
  const Eigen::MatrixXd gram = p * p.transpose();
  return core::SolveSymmetric(gram, Eigen::MatrixXd::Identity(p.rows(), p.rows()));
}

// Rounds to bytes; false if a value is not one.
bool ToBytes(std::span<const double> values, std::vector<std::uint8_t>& bytes) noexcept {
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (!(values[i] >= 0.0 && values[i] <= 255.0)) return false;
    const double above = values[i] + 0.5;  // lround() would take most of the time of a picture.
    bytes[i] = static_cast<std::uint8_t>(above);
  }
  return true;
}

}  // namespace

// The rows of one part of all demonstrations.
class StateReduction::Rows final : public RowSource {
 public:
  Rows(const Part& part, std::span<const core::Trajectory> demonstrations)
      : part_(part), demonstrations_(demonstrations), begin_{0} {
    begin_.reserve(demonstrations.size() + 1);
    for (const core::Trajectory& d : demonstrations) {
      begin_.push_back(begin_.back() + d.states.rows());
    }
  }

  [[nodiscard]] std::span<const Eigen::Index> begin() const noexcept { return begin_; }
  // First row of a demonstration; for the number of demonstrations, the number of rows.
  [[nodiscard]] Eigen::Index begin(std::size_t demonstration) const noexcept {
    return begin_[demonstration];
  }
  [[nodiscard]] Eigen::Index rows() const noexcept override { return begin_.back(); }
  [[nodiscard]] Eigen::Index width() const noexcept override {
    return part_.picture ? part_.picture->size() : part_.size;
  }
  void Read(Eigen::Index first, Eigen::Ref<core::Matrix> block) const override {
    std::optional<ImageFeatures> picture = part_.picture;
    std::vector<std::uint8_t> bytes(static_cast<std::size_t>(part_.size));
    std::vector<float> floats(static_cast<std::size_t>(width()));
    auto d = static_cast<std::size_t>(std::ranges::upper_bound(begin_, first) - begin_.begin()) - 1;
    for (Eigen::Index i = 0; i < block.rows(); ++i) {
      while (first + i >= begin_[d + 1]) ++d;
      const core::Matrix& states = demonstrations_[d].states;
      const Eigen::Index row = first + i - begin_[d];
      if (!picture) {
        block.row(i) = states.block(row, part_.offset, 1, part_.size);
        continue;
      }
      const auto values =
          core::Row(states, row).subspan(static_cast<std::size_t>(part_.offset), bytes.size());
      DFR_THROW_UNLESS(ToBytes(values, bytes),
                       "demonstration " << d << ", state " << row << ": the picture '" << part_.name
                                        << "' has a value outside of [0, 255]; pictures of another "
                                           "scale must be converted");
      DFR_THROW_UNLESS(picture->Apply(ViewOf(*picture, bytes), floats) == PictureFault::kNone,
                       "demonstration "
                           << d << ", state " << row << ": the picture '" << part_.name
                           << "' is black (values are 0 to 255, not 0 to 1); leave it out");
      block.row(i) =
          Eigen::Map<const Eigen::RowVectorXf>(floats.data(), block.cols()).cast<double>();
    }
  }

 private:
  const Part& part_;
  std::span<const core::Trajectory> demonstrations_;
  std::vector<Eigen::Index> begin_;  // First row of each demonstration; then the number of rows.
};

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
                   "the blocks beside reduced ones have together "
                       << reduced_dim() << " entries, at most " << kMostReducedEntries
                       << " are possible: put pca: before large ones");
}

std::vector<std::string> StateReduction::Names(std::string_view features) {
  std::vector<std::string> names;
  while (!features.empty()) {
    std::string_view item = Next(features, ',');
    const std::string_view prefix = core::ReductionPrefix(item);
    if (prefix.empty()) continue;
    item.remove_prefix(prefix.size());
    names.emplace_back(Next(item, ':'));
  }
  return names;
}

// Fits `components` at most, and the points and the novelty of the part.
Reduction StateReduction::FitPart(Part& part, int components,
                                  std::span<const core::Trajectory> demonstrations, int threads) {
  const Rows rows(part, demonstrations);
  std::vector<core::Matrix> episodes(demonstrations.size());
  const auto fit_novelty = [&](std::span<const core::Matrix> positions) {
    if (part.picture && demonstrations.size() > 1) {
      part.novelty = Novelty::Fit(rows, ShapeOf(*part.picture), rows.begin(), positions);
    }
  };
  if (part.kind == Kind::kPoints) {
    part.points = FeaturePoints::Fit(rows, ShapeOf(*part.picture));
    core::Workers workers(threads);
    workers.Run(episodes.size(), [&](std::size_t d) {
      core::Matrix pictures(rows.begin(d + 1) - rows.begin(d), rows.width());
      rows.Read(rows.begin(d), pictures);
      FeaturePoints::Workspace workspace(*part.points);
      std::vector<float> picture(static_cast<std::size_t>(rows.width()));
      episodes[d].resize(pictures.rows(), part.points->size());
      for (Eigen::Index i = 0; i < pictures.rows(); ++i) {
        std::ranges::transform(core::Row(pictures, i), picture.begin(),
                               [](double v) { return static_cast<float>(v); });
        part.points->Apply(picture, workspace, core::Row(episodes[d], i));
      }
    });
    fit_novelty(episodes);
    const SlowFeatures slow = FitSlowFeatures(episodes);
    const Eigen::Index kept = std::min<Eigen::Index>(components, slow.directions.rows());
    return {slow.mean, Eigen::VectorXd::Ones(slow.mean.size()), slow.directions.topRows(kept)};
  }
  fit_novelty({});
  PrincipalComponentsOptions options;
  options.components = part.kind == Kind::kSlow ? std::max(components, kMostChosen) : components;
  // The entries of a picture share a unit.
  if (part.picture) options.scale_floor = 1.0;
  options.threads = threads;
  const PrincipalComponents fit = FitPrincipalComponents(rows, options);
  if (part.kind == Kind::kPrincipal) {
    return Reduction::Principal(fit, static_cast<int>(fit.components.rows()));
  }
  for (std::size_t d = 0; d < episodes.size(); ++d) {
    episodes[d] = fit.scores.middleRows(rows.begin(d), rows.begin(d + 1) - rows.begin(d));
  }
  const SlowFeatures slow = FitSlowFeatures(episodes);
  const Eigen::Index kept = std::min<Eigen::Index>(components, slow.directions.rows());
  // The mean of the scores is zero.
  return {fit.mean, fit.scale, slow.directions.topRows(kept) * fit.components};
}

StateReduction StateReduction::Fit(const core::StateLayout& layout, std::string_view features,
                                   std::span<const core::Trajectory> demonstrations, int threads) {
  std::vector<Part> parts;
  std::string plain;
  const auto add = [&](Part part, std::string_view feature) {
    const bool again = std::ranges::count(parts, part.name, &Part::name) > 0;
    // Several ranges of one block are one part.
    DFR_THROW_UNLESS(!again || !part.reduction,
                     "feature '" << feature << "' names a block that is there already");
    for (const Part& other : parts) {
      DFR_THROW_UNLESS(other.name != part.name || !other.reduction,
                       "feature '" << feature << "' is part of a block that is reduced");
    }
    if (!again) parts.push_back(std::move(part));
    plain.append(plain.empty() ? "" : ",").append(feature);
  };
  while (!features.empty()) {
    const std::string_view item = Next(features, ',');
    const std::string_view prefix = core::ReductionPrefix(item);
    const auto kind = static_cast<Kind>(std::ranges::find(kPrefixes, prefix) - kPrefixes.begin());
    const std::optional<Asked> asked =
        prefix.empty() ? std::nullopt
                       : std::optional(ParseAsked(layout, item, kind == Kind::kPoints));
    const std::string name = asked ? asked->name : std::string(item.substr(0, item.find('[')));
    const auto block = std::ranges::find(layout.blocks, name, &core::StateLayout::Block::name);
    if (block == layout.blocks.end()) core::FeatureSelection(layout, item);  // Throws.
    Part part{.name = name, .offset = block->offset, .size = block->size, .kind = kind};
    if (!asked) {
      DFR_THROW_UNLESS(block->picture.height == 0,
                       "feature '" << item << "' is a picture: put points: or pca: before it");
      add(std::move(part), item);
      continue;
    }
    if (asked->picture) part.picture.emplace(*asked->picture);
    part.open = asked->components == 0;
    try {
      Reduction reduction =
          FitPart(part, part.open ? kMostChosen : asked->components, demonstrations, threads);
      DFR_THROW_UNLESS(
          reduction.num_components() >= asked->components,
          "there are " << reduction.num_components() << " components, not " << asked->components);
      part.reduction = std::move(reduction);
    } catch (const std::invalid_argument& e) {
      throw std::invalid_argument("feature '" + std::string(item) + "': " + e.what());
    }
    add(std::move(part), std::string(prefix) + name);
  }
  return {layout, std::move(parts), std::move(plain)};
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

// `points` and `positions` are used if the part has points, `novelty` if it has a novelty.
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
    good = good && AllFinite(out);
  }
  if (!good) {
    std::ranges::fill(workspace.state_, std::numeric_limits<double>::quiet_NaN());
    workspace.novelty_ = 0.0;
  }
  return good;
}

std::string StateReduction::Fault(std::span<const double> state) const {
  if (static_cast<int>(state.size()) != state_dim()) {
    return core::Format("state has %zu entries, %d needed", state.size(), state_dim());
  }
  Workspace workspace(*this);
  std::size_t next_picture = 0;
  std::size_t next_points = 0;
  std::string strange;  // Named if there is no other fault.
  for (const Part& part : parts_) {
    const auto in =
        state.subspan(static_cast<std::size_t>(part.offset), static_cast<std::size_t>(part.size));
    const auto bad = std::ranges::find_if(in, [&](double v) {
      return !std::isfinite(v) || (part.picture && !(v >= 0.0 && v <= 255.0));
    });
    if (bad != in.end()) {
      return part.name + core::Format("[%td] of the state is %g", bad - in.begin(), *bad) +
             (std::isfinite(*bad) ? ", a picture has values from 0 to 255" : "");
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
          "the picture '%s' resembles no demonstration: its difference from them is %.3g times the "
          "limit; remove what they do not show, or add demonstrations that show it",
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
      // Column and row of each point.
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
    DFR_THROW_UNLESS(!part.points, "the block '" << block
                                                 << "' is reduced to positions of patches, which "
                                                    "show no picture; pca: and slow: do");
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

double StateReduction::novel_left_out() const noexcept {
  double most = 0.0;
  for (const Part& part : parts_) {
    if (part.novelty) most = std::max(most, part.novelty->left_out());
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
      if (block == layout.blocks.end()) archive.Fail("reduces a block that the state lacks");
      part.offset = block->offset;
      part.size = block->size;
      part.open = archive.IntegerIn(0, 1) == 1;
      part.kind = static_cast<Kind>(archive.IntegerIn(0, static_cast<int>(Kind::kSlow)));
      const bool reduced = part.kind != Kind::kCopied;
      if (part.open && !reduced) archive.Fail("leaves the components of a copied block open");
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
          if (!part.picture) archive.Fail("has points of a block that is no picture");
          part.points = FeaturePoints::Load(archive, ShapeOf(*part.picture));
          width = part.points->size();
        }
        part.reduction = Reduction::Load(archive);
        if (part.reduction->input_dim() != width) {
          archive.Fail("holds a reduction of another number of entries");
        }
        if (part.picture && archive.IntegerIn(0, 1) == 1) {
          part.novelty = Novelty::Load(archive, ShapeOf(*part.picture));
          if (part.novelty->num_positions() != (part.points ? part.points->size() : 0)) {
            archive.Fail("holds a limit of novelty of another number of positions");
          }
        }
      }
      parts.push_back(std::move(part));
    }
    return {layout, std::move(parts), std::move(features)};
  } catch (const std::invalid_argument& e) {
    archive.Fail(std::string("holds no reduction of states: ") + e.what());
  }
}

}  // namespace dfr::reduction
