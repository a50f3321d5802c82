#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/features/features.h"
#include "dfr/core/files/archive.h"
#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"
#include "dfr/reduction/feature_points.h"
#include "dfr/reduction/image_features.h"
#include "dfr/reduction/novelty.h"
#include "dfr/reduction/reduction.h"

namespace dfr::reduction {

/// Map from a state with pictures or other large blocks to the few entries that a guard uses.
///
/// Defined by a list of features such as "points:image,tip[0:2]". A block after a prefix is
/// reduced, other listed blocks are copied whole, and all others are omitted:
///
///   points:NAME[:K][:grey][:HxW][:light=none|gain|standard]
///
/// points:  slow features (SlowFeatures) of the positions of patches (FeaturePoints) of a picture
/// pca:     principal components of a picture or of another block
/// slow:    slow features of the leading principal components, at least kMostChosen of them
///
/// K is the number of components. Without K, the caller chooses the number. The other options are
/// for pictures (core::StateLayout::Block::picture): one channel, the size after averaging, and the
/// normalisation of light (LightNormalisation; "standard", the default, is kGainAndOffset). Without
/// a size, points: averages larger pictures to 32 pixels along the longer side.
///
/// Immutable. Share one object, because copying is slow. Concurrent calls with separate workspaces
/// are safe.
class StateReduction {
 public:
  /// Maximum number of fitted components if the list does not give the number.
  static constexpr int kMostChosen = 48;

  /// Scratch memory of one thread.
  class Workspace {
   public:
    explicit Workspace(const StateReduction& reduction);
    /// Returns the result of Apply(): reduced_dim() entries.
    [[nodiscard]] std::span<const double> state() const noexcept { return state_; }
    /// Returns the largest Novelty of the pictures of the last Apply(): above 1, a picture
    /// resembles no demonstration. Returns 0 if no picture has a Novelty, or if Apply() rejected
    /// the state.
    [[nodiscard]] double novelty() const noexcept { return novelty_; }

   private:
    friend class StateReduction;
    std::vector<ImageFeatures> pictures_;  // One per part that is a picture.
    std::vector<std::uint8_t> bytes_;
    std::vector<FeaturePoints::Workspace> points_;  // One per part with points.
    std::vector<float> floats_;
    std::vector<double> positions_;
    std::vector<Novelty::Workspace> novelties_;  // One per part that is a picture.
    std::vector<double> state_;
    double novelty_ = 0.0;
  };

  /// Returns the blocks after a prefix such as "pca:" in a list of features, with the requested
  /// sizes. Ignores malformed options, which Fit() rejects.
  [[nodiscard]] static std::vector<core::BlockRequest> Requests(std::string_view features);

  /// Checks features for Fit(), or for core::FeatureSelection if none is reduced, without
  /// demonstrations.
  /// @throws std::invalid_argument naming the feature and its defect.
  static void CheckFeatures(const core::StateLayout& layout, std::string_view features);

  /// Fits the components and the novelty of pictures to the states of all demonstrations. A block
  /// whose request gives no number of components gets at most kMostChosen.
  /// @param threads  0: one per core. The result does not depend on it.
  /// @throws std::invalid_argument naming the feature or the demonstration, and its defect.
  static StateReduction Fit(const core::StateLayout& layout, std::string_view features,
                            std::span<const core::Trajectory> demonstrations, int threads = 0);

  /// Returns a copy with at most the first `components` components of each block whose request
  /// gives no number.
  [[nodiscard]] StateReduction WithComponents(int components) const;
  /// Returns a copy whose components are linear combinations of the present components.
  /// @param weights  for each block whose request gives no number of components, one row for each
  ///   new component.
  [[nodiscard]] StateReduction Combined(std::span<const core::Matrix> weights) const;
  /// Returns the number of blocks whose requests give no number of components.
  [[nodiscard]] int num_open() const noexcept;
  /// Returns the largest number of components of the blocks that num_open() counts.
  [[nodiscard]] int most_components() const noexcept;
  /// Returns true if a block that num_open() counts is a picture whose components are sums of
  /// pixels, not points.
  [[nodiscard]] bool sums_open_pixels() const noexcept;
  /// Returns the columns of a reduced state in this order: those that do not depend on the number
  /// of components, then the first component of each block that num_open() counts, then the second
  /// of each, and so on.
  [[nodiscard]] std::vector<int> InOrderOfComponents() const;
  /// Returns the positions in InOrderOfComponents() of the columns of each block that num_open()
  /// counts.
  [[nodiscard]] std::vector<std::vector<int>> PositionsInOrder() const;

  /// Returns the layout of unreduced states.
  [[nodiscard]] const core::StateLayout& layout() const noexcept { return layout_; }
  [[nodiscard]] int state_dim() const noexcept { return layout_.state_dim(); }
  /// Returns the layout of reduced states: a block such as "pca:NAME" for each reduced one, and the
  /// copied blocks.
  [[nodiscard]] const core::StateLayout& reduced_layout() const noexcept { return reduced_; }
  [[nodiscard]] int reduced_dim() const noexcept { return reduced_.state_dim(); }
  /// Returns the features of reduced states for core::FeatureSelection: "pca:image,tip[0:2]".
  [[nodiscard]] const std::string& features() const noexcept { return features_; }

  /// Reduces a state into `workspace`, which must belong to this reduction. Never allocates, locks
  /// or throws. @returns false, and writes NaN, for a wrong size, a non-finite entry, and a picture
  /// that is black or has a value outside [0, 255].
  bool Apply(std::span<const double> state, Workspace& workspace) const noexcept;
  /// Describes the reason why Apply() rejects a state, or the picture that resembles no
  /// demonstration; "" for other states.
  [[nodiscard]] std::string Fault(std::span<const double> state) const;

  /// Distributes the shares of reduced entries among the entries of `state`, which Apply() must
  /// accept. `products` is the sum of g dz' over the steps dz of a path of reduced states, with
  /// gradients g: entry i of a block with map P gets (P' g)_i (P^+ dz)_i, where P^+ is the
  /// pseudo-inverse. The sum over all entries is the trace of `products`. The share of a feature
  /// point goes to the pixels of the point in this state.
  void Spread(const Eigen::MatrixXd& products, std::span<const double> state,
              std::span<double> shares) const;
  /// Reconstruction of a block of a state from its components: mean + scale P^+ z.
  struct Seen {
    core::PictureShape shape;  ///< Shape of the reduced picture; zero for other blocks.
    std::vector<double> values;
  };
  /// @param block  the name of a reduced block.
  /// @throws std::invalid_argument if there is no such block, if it is reduced to points, which
  /// cannot be shown as a picture, or, with the text of Fault(), if Apply() rejects the state.
  [[nodiscard]] Seen Reconstruct(std::string_view block, std::span<const double> state) const;

  /// Returns the largest Novelty::left_out() of the pictures; std::nullopt without pictures of at
  /// least two demonstrations.
  [[nodiscard]] std::optional<double> novel_left_out() const noexcept;

  /// Appends all data except the layout to a file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote. @throws std::runtime_error naming the file and its defect.
  static StateReduction Load(core::ArchiveReader& archive, const core::StateLayout& layout);

 private:
  /// Files store these values.
  enum class Kind { kCopied, kPrincipal, kPoints, kSlow };
  /// A block of the state and its reduction.
  struct Part {
    std::string name;
    int offset = 0;  ///< Position in the state.
    int size = 0;
    int first = 0;  ///< Position in the reduced state.
    Kind kind = Kind::kCopied;
    bool open = false;  ///< True if the list does not give the number of components.
    // Stages in the order of their application. Without any stage, the entries are copied.
    std::optional<ImageFeatures> picture = {};
    std::optional<FeaturePoints> points = {};
    std::optional<Reduction> reduction = {};
    /// Set for pictures of at least two demonstrations.
    std::optional<Novelty> novelty = {};

    [[nodiscard]] int reduced_size() const noexcept {
      return reduction ? reduction->num_components() : size;
    }
  };
  /// An entry of a list of features.
  struct Requested {
    Part part;  ///< Its reduction is missing.
    std::string item;
    std::string feature;   ///< Feature of reduced states.
    bool reduces = false;  ///< False: entries are copied.
    int components = 0;    ///< 0: Fit() chooses.
  };
  class Rows;

  static std::vector<Requested> Parse(const core::StateLayout& layout, std::string_view features);
  static Reduction FitPart(Part& part, int components,
                           std::span<const core::Trajectory> demonstrations, int threads);
  /// Reduces a picture to `out` and returns its novelty.
  static double ReducePicture(const Part& part, std::span<const float> picture,
                              FeaturePoints::Workspace* points, std::span<double> positions,
                              Novelty::Workspace& novelty, std::span<double> out) noexcept;

  StateReduction(core::StateLayout layout, std::vector<Part> parts, std::string features);

  core::StateLayout layout_;
  core::StateLayout reduced_;
  std::vector<Part> parts_;
  std::string features_;
};

}  // namespace dfr::reduction
