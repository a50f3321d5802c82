#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/features/state_map.h"
#include "dfr/core/matrix.h"

namespace dfr::core {

/// Shape of a picture: rows of pixels from the top, interleaved channels.
struct PictureShape {
  int height = 0;
  int width = 0;
  int channels = 0;
  bool operator==(const PictureShape&) const = default;
};

/// Names of the parts of a state vector: block "object" is entries [offset, offset + size). The
/// same names are the `obs/<key>` datasets of a demonstration file.
struct StateLayout {
  struct Block {
    std::string name;
    int offset = 0;
    int size = 0;
    /// Shape of the picture if the entries are pixels from 0 to 255; otherwise all zero.
    PictureShape picture = {};
    bool operator==(const Block&) const = default;
  };
  std::vector<Block> blocks;

  /// Maximum number of entries of a state.
  static constexpr int kMaxStateDim = 1 << 20;

  /// Appends a block.
  /// @throws std::invalid_argument if the block is empty or the state would exceed kMaxStateDim.
  void Add(std::string name, int size);
  /// Appends a picture. @throws std::invalid_argument also if it has neither 1 nor 3 channels.
  void Add(std::string name, const PictureShape& picture);
  [[nodiscard]] int state_dim() const noexcept;
  bool operator==(const StateLayout&) const = default;
};

/// A block that a reader adds to the states only if a feature needs it.
struct BlockRequest {
  std::string name;
  /// Size to which the frames of a video are averaged, in pixels; 0: the reader's choice.
  int height = 0;
  int width = 0;
  bool operator==(const BlockRequest&) const = default;
};

/// The entries of a state that an estimator uses.
class FeatureSelection {
 public:
  /// Parses "object,tip[0:2]": whole blocks or half-open index ranges within one block. The
  /// features keep the order of the text.
  /// @throws std::invalid_argument naming the unknown block, the invalid range or the duplicate,
  ///   and listing the valid blocks.
  FeatureSelection(const StateLayout& layout, std::string_view spec);
  /// Selects every entry of a state of `state_dim` entries.
  static FeatureSelection All(int state_dim);
  /// Selects the entries named by `spec`, or every entry if it is empty.
  static FeatureSelection Of(const StateLayout& layout, std::string_view spec);
  /// Returns the same selection on states that `map` has made continuous. An entry with a
  /// StateMap::Circle becomes two features. Mapped entries that are not selected have no effect.
  /// @throws std::invalid_argument if a state is too short for the map.
  [[nodiscard]] FeatureSelection Mapped(StateMap map) const;

  [[nodiscard]] int state_dim() const noexcept { return state_dim_; }
  [[nodiscard]] int num_features() const noexcept { return static_cast<int>(indices_.size()); }
  /// Returns the entry of each feature. The entry of a StateMap::Circle occurs twice in a row.
  [[nodiscard]] const std::vector<int>& indices() const noexcept { return indices_; }
  /// Returns the `spec` from which Of() made this selection; empty for All().
  [[nodiscard]] const std::string& spec() const noexcept { return spec_; }
  /// Returns the map that makes states continuous before their features are taken.
  [[nodiscard]] const StateMap& map() const noexcept { return map_; }

  /// Writes the derivative of each feature of `state` with respect to its entry. Never allocates.
  void Slopes(std::span<const double> state, std::span<double> slopes) const noexcept;
  /// Writes the features of `state` (state_dim()) to `features` (num_features()). Never allocates.
  void Apply(std::span<const double> state, std::span<double> features) const noexcept;
  /// Returns the features of each row.
  [[nodiscard]] Matrix Apply(const Matrix& states) const;

 private:
  FeatureSelection() = default;
  int state_dim_ = 0;
  std::vector<int> indices_;
  std::string spec_;
  StateMap map_;
};

/// Returns the prefix of a feature that denotes a reduced block, such as "pca:" of "pca:image"
/// (reduction::StateReduction); "" if there is none.
[[nodiscard]] std::string_view ReductionPrefix(std::string_view feature) noexcept;

/// Returns the feature list of a command line, "obs/object,obs/tip[0:2]", in the form for
/// FeatureSelection: removes "obs/" or "observations/", which precedes a name in a file.
[[nodiscard]] std::string StripObservationPrefixes(std::string_view features);

}  // namespace dfr::core
