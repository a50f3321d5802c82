#include <algorithm>
#include <span>
#include <stdexcept>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/text/numbers.h"
#include "dfr/core/text/take_until.h"
#include "dfr/core/workers.h"
#include "dfr/reduction/principal_components.h"
#include "dfr/reduction/slow_features.h"
#include "dfr/reduction/state_reduction.h"
#include "state_pictures.h"

namespace dfr::reduction {
namespace {

using internal::kPrefixes;
using internal::ShapeOf;
using internal::ToBytes;
using internal::ViewOf;

// Longer side of the pictures that are reduced to points, in pixels, unless a size is given.
constexpr int kSideOfPoints = 32;

// Parses a size such as "32x24", height first.
std::optional<std::pair<int, int>> ParseSize(std::string_view text) {
  const std::string_view height = core::TakeUntil(text, 'x');
  const auto rows = core::ParseInteger<int>(height);
  const auto columns = core::ParseInteger<int>(text);
  if (!rows || !columns || *rows < 1 || *columns < 1) return std::nullopt;
  return std::pair(*rows, *columns);
}

std::optional<LightNormalisation> ParseLight(std::string_view text) {
  if (text == "light=none") return LightNormalisation::kNone;
  if (text == "light=gain") return LightNormalisation::kGain;
  if (text == "light=standard") return LightNormalisation::kGainAndOffset;
  return std::nullopt;
}

// A reduced block in a list of features.
struct Asked {
  std::string name;
  int components = 0;  // 0: the caller chooses.
  std::optional<ImageFeaturesOptions> picture = {};
};

Asked ParseAsked(const core::StateLayout& layout, std::string_view item, bool points) {
  std::string_view rest = item.substr(core::ReductionPrefix(item).size());
  Asked asked{.name = std::string(core::TakeUntil(rest, ':'))};
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
    const std::string_view option = core::TakeUntil(rest, ':');
    if (const auto components = core::ParseInteger<int>(option)) {
      DFR_THROW_UNLESS(*components >= 1 && *components <= Reduction::kMaxComponents,
                       "feature '" << item << "': the number of components must lie in [1, "
                                   << Reduction::kMaxComponents << "]");
      asked.components = *components;
      continue;
    }
    const auto size = ParseSize(option);
    const auto light = ParseLight(option);
    DFR_THROW_UNLESS(
        size || light || option == "grey",
        "feature '" << item << "': '" << option
                    << "' is not an option; options are a number of components, grey, a size "
                       "such as 32x32, and light=none, light=gain or light=standard");
    DFR_THROW_UNLESS(asked.picture, "feature '" << item << "': '" << option
                                                << "' is for pictures; give the block the shape "
                                                   "(height, width, channels) in the layout");
    if (size) {
      std::tie(asked.picture->out_height, asked.picture->out_width) = *size;
      DFR_THROW_UNLESS(size->first <= shape.height && size->second <= shape.width,
                       "feature '" << item << "': " << option
                                   << " is larger than the pictures, which have " << shape.height
                                   << "x" << shape.width << " pixels (height x width)");
    }
    if (light) asked.picture->light = *light;
    if (option == "grey") asked.picture->grey = true;
  }
  return asked;
}

// Calls function(). Its std::invalid_argument gets the name of the feature.
template <typename Function>
void WithItem(std::string_view item, Function function) {
  try {
    function();
  } catch (const std::invalid_argument& e) {
    throw std::invalid_argument("feature '" + std::string(item) + "': " + e.what());
  }
}

}  // namespace

// Rows of one part in all demonstrations.
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
  // Returns the first row of a demonstration. For the index after the last demonstration, returns
  // the number of rows.
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
                       "demonstration "
                           << d << ", state " << row << ": the picture '" << part_.name
                           << "' has a value outside [0, 255]; convert pictures of another "
                              "scale");
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
  // First row of each demonstration, followed by the number of rows.
  std::vector<Eigen::Index> begin_;
};

std::vector<core::BlockRequest> StateReduction::Requests(std::string_view features) {
  std::vector<core::BlockRequest> requests;
  while (!features.empty()) {
    std::string_view item = core::TakeUntil(features, ',');
    const std::string_view prefix = core::ReductionPrefix(item);
    if (prefix.empty()) continue;
    item.remove_prefix(prefix.size());
    core::BlockRequest& request = requests.emplace_back();
    request.name = core::TakeUntil(item, ':');
    while (!item.empty()) {
      const auto size = ParseSize(core::TakeUntil(item, ':'));
      if (size) std::tie(request.height, request.width) = *size;
    }
  }
  return requests;
}

// Fits the part: at most `components` components, its points and its novelty.
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
  // All entries of a picture have the same unit.
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
  return {fit.mean, fit.scale, core::Multiply(slow.directions.topRows(kept), fit.components)};
}

std::vector<StateReduction::Requested> StateReduction::Parse(const core::StateLayout& layout,
                                                             std::string_view features) {
  std::vector<Requested> requested;
  std::string copied;
  while (!features.empty()) {
    const std::string_view item = core::TakeUntil(features, ',');
    const std::string_view prefix = core::ReductionPrefix(item);
    const auto kind = static_cast<Kind>(std::ranges::find(kPrefixes, prefix) - kPrefixes.begin());
    const std::optional<Asked> asked =
        prefix.empty() ? std::nullopt
                       : std::optional(ParseAsked(layout, item, kind == Kind::kPoints));
    const std::string name = asked ? asked->name : std::string(item.substr(0, item.find('[')));
    const auto block = std::ranges::find(layout.blocks, name, &core::StateLayout::Block::name);
    if (block == layout.blocks.end()) core::FeatureSelection(layout, item);  // Throws.
    Requested& added = requested.emplace_back();
    added.part.name = name;
    added.part.offset = block->offset;
    added.part.size = block->size;
    added.part.kind = kind;
    added.item = item;
    added.feature = asked ? std::string(prefix) + name : std::string(item);
    added.reduces = asked.has_value();
    DFR_THROW_UNLESS(asked || block->picture.height == 0,
                     "feature '" << item << "' is a picture: put points: or pca: before it");
    if (asked) {
      added.components = asked->components;
      added.part.open = asked->components == 0;
      WithItem(item, [&] {
        if (asked->picture) added.part.picture.emplace(*asked->picture);
        if (kind == Kind::kPoints) FeaturePoints::CheckShape(ShapeOf(*added.part.picture));
      });
    } else {
      copied.append(copied.empty() ? "" : ",").append(item);
    }
    for (const Requested& other : std::span(requested).first(requested.size() - 1)) {
      if (other.part.name != name) continue;
      // Several ranges of a block form one part.
      DFR_THROW_UNLESS(!asked,
                       "feature '" << added.feature << "' names a block that is listed already");
      DFR_THROW_UNLESS(!other.reduces,
                       "feature '" << added.feature << "' is part of a block that is reduced");
    }
  }
  if (!copied.empty()) core::FeatureSelection(layout, copied);
  return requested;
}

void StateReduction::CheckFeatures(const core::StateLayout& layout, std::string_view features) {
  if (Requests(features).empty()) {
    static_cast<void>(core::FeatureSelection::Of(layout, features));
  } else {
    static_cast<void>(Parse(layout, features));
  }
}

StateReduction StateReduction::Fit(const core::StateLayout& layout, std::string_view features,
                                   std::span<const core::Trajectory> demonstrations, int threads) {
  std::vector<Part> parts;
  std::string plain;
  for (Requested& requested : Parse(layout, features)) {
    Part& part = requested.part;
    plain.append(plain.empty() ? "" : ",").append(requested.feature);
    if (!requested.reduces) {
      if (std::ranges::count(parts, part.name, &Part::name) == 0) parts.push_back(std::move(part));
      continue;
    }
    WithItem(requested.item, [&] {
      const int components = requested.components;
      Reduction reduction =
          FitPart(part, part.open ? kMostChosen : components, demonstrations, threads);
      DFR_THROW_UNLESS(
          reduction.num_components() >= components,
          "there are " << reduction.num_components() << " components, not " << components);
      part.reduction = std::move(reduction);
    });
    parts.push_back(std::move(part));
  }
  return {layout, std::move(parts), std::move(plain)};
}

}  // namespace dfr::reduction
