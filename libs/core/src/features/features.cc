#include "dfr/core/features/features.h"

#include <algorithm>
#include <array>
#include <numeric>
#include <optional>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/text/numbers.h"

namespace dfr::core {
namespace {

// Index range of "name" or "name[first:last]" within the state.
struct Range {
  int first;
  int last;
};

std::string KnownBlocks(const StateLayout& layout) {
  std::string names;
  for (const auto& block : layout.blocks) {
    names += (names.empty() ? "" : ", ") + block.name + "[0:" + std::to_string(block.size) + "]";
  }
  return names;
}

// Returns the length of the name at the beginning of a list. It is the longest name of a block that
// matches, because names may contain brackets and commas.
std::size_t NameLength(const StateLayout& layout, std::string_view spec) {
  std::size_t longest = 0;
  for (const auto& block : layout.blocks) {
    const std::size_t size = block.name.size();
    const bool ends =
        spec.size() == size || (spec.size() > size && (spec[size] == ',' || spec[size] == '['));
    if (ends && spec.starts_with(block.name)) longest = std::max(longest, size);
  }
  return longest > 0 ? longest : std::min(spec.size(), spec.find_first_of("[,"));
}

Range ParseItem(const StateLayout& layout, std::string_view item, std::size_t name_length) {
  const std::size_t bracket = name_length < item.size() ? name_length : std::string_view::npos;
  const std::string_view name = item.substr(0, name_length);
  const auto block = std::find_if(layout.blocks.begin(), layout.blocks.end(),
                                  [&](const auto& b) { return b.name == name; });
  DFR_THROW_UNLESS(block != layout.blocks.end(), "feature '" << name
                                                             << "' is not part of the state; "
                                                             << "it has " << KnownBlocks(layout));
  Range range{0, block->size};
  if (bracket != std::string_view::npos) {
    const std::string_view inside = item.substr(bracket);
    const std::size_t colon = inside.find(':');
    std::optional<int> first;
    std::optional<int> last;
    if (colon != std::string_view::npos && inside.back() == ']') {
      first = ParseInteger<int>(inside.substr(1, colon - 1));
      last = ParseInteger<int>(inside.substr(colon + 1, inside.size() - colon - 2));
    }
    DFR_THROW_UNLESS(first && last, "feature '" << item << "': write a range as name[first:last] "
                                                << "with whole numbers");
    range = {*first, *last};
    DFR_THROW_UNLESS(
        0 <= range.first && range.first < range.last && range.last <= block->size,
        "feature '" << item << "' is empty or not within " << name << "[0:" << block->size << "]");
  }
  return {block->offset + range.first, block->offset + range.last};
}

}  // namespace

void StateLayout::Add(std::string name, int size) {
  DFR_THROW_UNLESS(size > 0, "state block '" << name << "' needs at least one entry");
  const int offset = state_dim();
  DFR_THROW_UNLESS(size <= kMaxStateDim - offset,
                   "the block '" << name << "' of " << size << " entries makes a state longer than "
                                 << kMaxStateDim);
  blocks.push_back({.name = std::move(name), .offset = offset, .size = size});
}

void StateLayout::Add(std::string name, const PictureShape& picture) {
  const auto [height, width, channels] = picture;
  DFR_THROW_UNLESS(height > 0 && width > 0 && (channels == 1 || channels == 3),
                   "the picture '" << name << "' of " << height << " x " << width << " x "
                                   << channels
                                   << " needs positive sizes and 1 or 3 channels (last)");
  DFR_THROW_UNLESS(height <= kMaxStateDim / width / channels,
                   "the picture '" << name << "' of " << height << " x " << width << " x "
                                   << channels << " has more than " << kMaxStateDim << " entries");
  Add(std::move(name), height * width * channels);
  blocks.back().picture = picture;
}

int StateLayout::state_dim() const noexcept {
  return blocks.empty() ? 0 : blocks.back().offset + blocks.back().size;
}

FeatureSelection::FeatureSelection(const StateLayout& layout, std::string_view spec)
    : state_dim_(layout.state_dim()), spec_(spec) {
  DFR_THROW_UNLESS(!spec.empty(), "no feature is named; the state has " << KnownBlocks(layout));
  std::vector<bool> taken(static_cast<std::size_t>(state_dim_), false);
  while (true) {
    const std::size_t name_length = NameLength(layout, spec);
    const std::size_t comma = spec.find(',', name_length);
    const std::string_view item = spec.substr(0, comma);
    const Range range = ParseItem(layout, item, name_length);
    for (int i = range.first; i < range.last; ++i) {
      DFR_THROW_UNLESS(!taken[static_cast<std::size_t>(i)],
                       "feature '" << item << "' repeats an entry");
      taken[static_cast<std::size_t>(i)] = true;
      indices_.push_back(i);
    }
    if (comma == std::string_view::npos) break;
    spec.remove_prefix(comma + 1);
  }
}

FeatureSelection FeatureSelection::All(int state_dim) {
  DFR_THROW_UNLESS(state_dim > 0, "state_dim must be positive, not " << state_dim);
  FeatureSelection selection;
  selection.state_dim_ = state_dim;
  selection.indices_.resize(static_cast<std::size_t>(state_dim));
  std::iota(selection.indices_.begin(), selection.indices_.end(), 0);
  return selection;
}

FeatureSelection FeatureSelection::Of(const StateLayout& layout, std::string_view spec) {
  return spec.empty() ? All(layout.state_dim()) : FeatureSelection(layout, spec);
}

FeatureSelection FeatureSelection::Mapped(StateMap map) const {
  DFR_THROW_UNLESS(map.least_state_dim() <= state_dim_, "the rotations need states of at least "
                                                            << map.least_state_dim()
                                                            << " entries, not " << state_dim_);
  FeatureSelection mapped = *this;
  mapped.map_ = std::move(map);
  mapped.indices_.erase(std::unique(mapped.indices_.begin(), mapped.indices_.end()),
                        mapped.indices_.end());
  for (const StateMap::Circle& circle : mapped.map_.circles()) {
    const auto at = std::find(mapped.indices_.begin(), mapped.indices_.end(), circle.entry);
    if (at != mapped.indices_.end()) mapped.indices_.insert(at, circle.entry);
  }
  return mapped;
}

void FeatureSelection::Slopes(std::span<const double> state,
                              std::span<double> slopes) const noexcept {
  for (std::size_t i = 0; i < indices_.size(); ++i) {
    const int entry = indices_[i];
    if (const StateMap::Circle* const circle = map_.FindCircle(entry)) {
      const auto tangent = circle->Tangent(state[static_cast<std::size_t>(entry)]);
      slopes[i] = tangent[0];
      slopes[++i] = tangent[1];
    } else {
      slopes[i] = map_.Slope(state, entry);
    }
  }
}

void FeatureSelection::Apply(std::span<const double> state,
                             std::span<double> features) const noexcept {
  if (!map_.empty()) {
    for (std::size_t i = 0; i < indices_.size(); ++i) {
      const int entry = indices_[i];
      if (const StateMap::Circle* const circle = map_.FindCircle(entry)) {
        const auto point = circle->Point(state[static_cast<std::size_t>(entry)]);
        features[i] = point[0];
        features[++i] = point[1];
      } else {
        features[i] = map_.Value(state, entry);
      }
    }
    return;
  }
  for (std::size_t i = 0; i < indices_.size(); ++i) {
    features[i] = state[static_cast<std::size_t>(indices_[i])];
  }
}

Matrix FeatureSelection::Apply(const Matrix& states) const {
  DFR_THROW_UNLESS(states.cols() == state_dim_,
                   "states have " << states.cols() << " columns, not " << state_dim_);
  Matrix features(states.rows(), num_features());
  for (Eigen::Index i = 0; i < states.rows(); ++i) Apply(Row(states, i), Row(features, i));
  return features;
}

std::string_view ReductionPrefix(std::string_view feature) noexcept {
  constexpr std::array<std::string_view, 3> kPrefixes = {"pca:", "points:", "slow:"};
  for (const std::string_view prefix : kPrefixes) {
    if (feature.starts_with(prefix)) return prefix;
  }
  return {};
}

std::string StripObservationPrefixes(std::string_view features) {
  constexpr std::array<std::string_view, 2> kPrefixes = {"obs/", "observations/"};
  std::string stripped;
  while (!features.empty()) {
    std::string_view item = features.substr(0, features.find(','));
    features.remove_prefix(std::min(features.size(), item.size() + 1));
    if (!stripped.empty()) stripped += ',';
    const std::string_view reduced = ReductionPrefix(item);
    stripped += reduced;
    item.remove_prefix(reduced.size());
    for (const std::string_view prefix : kPrefixes) {
      if (item.starts_with(prefix)) item.remove_prefix(prefix.size());
    }
    stripped += item;
  }
  return stripped;
}

}  // namespace dfr::core
