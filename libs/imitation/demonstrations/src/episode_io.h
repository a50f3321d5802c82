#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/core/features/features.h"
#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"
#include "dfr/imitation/demonstrations.h"
#include "hdf5/hdf5_file.h"
#include "hdf5/hdf5_reader.h"

namespace dfr::imitation::internal {

// Common code of the two HDF5 formats.

/// @throws std::invalid_argument unless the trajectory has these dimensions, finite states and
///   controls within [-1, 1]. The message names `episode`, step and entry.
void CheckTrajectory(const core::Trajectory& trajectory, int state_dim, int control_dim,
                     int episode);

/// Appends all trajectories of a set. Checks all of them before it calls `create()`, which replaces
/// an existing file. Returns the writer.
template <typename Create>
auto WriteAll(const DemonstrationSet& demonstrations, const Create& create) {
  const int state_dim = demonstrations.layout.state_dim();
  int episode = 0;
  for (const auto& trajectory : demonstrations.trajectories) {
    CheckTrajectory(trajectory, state_dim, demonstrations.control_dim, episode++);
  }
  auto writer = create();
  for (const auto& trajectory : demonstrations.trajectories) writer.Append(trajectory);
  return writer;
}

/// @throws std::invalid_argument unless every block's name is a valid dataset name.
void CheckLayout(const core::StateLayout& layout, int control_dim);

/// Reads a dataset of finite numbers with this many rows. `count` names the source of that number
/// in messages.
[[nodiscard]] core::Matrix ReadRows(const Hdf5Reader& file, const std::string& path,
                                    Eigen::Index rows, const char* count);

/// Reads the datasets of a layout, concatenated by columns.
[[nodiscard]] core::Matrix ReadBlocks(const Hdf5Reader& file, const std::string& group,
                                      const core::StateLayout& layout, Eigen::Index rows,
                                      const char* count);

/// Common part of both readers: the episodes of a file in the order of their numbers. All episodes
/// must have the layout of the first one.
class EpisodeReader : public DemonstrationReader {
 public:
  [[nodiscard]] const core::StateLayout& layout() const noexcept override { return layout_; }
  [[nodiscard]] int control_dim() const noexcept override { return controls_.state_dim(); }
  [[nodiscard]] const std::string& environment() const noexcept override { return environment_; }
  [[nodiscard]] int num_episodes() const noexcept override {
    return static_cast<int>(episodes_.size());
  }
  [[nodiscard]] const std::string& name(int i) const override {
    return episodes_.at(static_cast<std::size_t>(i));
  }
  [[nodiscard]] core::Trajectory Read(int i) const override;
  [[nodiscard]] const std::string& note() const noexcept override { return note_; }

 protected:
  void SetNote(std::string note) { note_ = std::move(note); }
  /// @param pictures  datasets of pictures to read as parts of the state.
  explicit EpisodeReader(Hdf5Reader file, std::vector<std::string> pictures = {})
      : file_(std::move(file)), pictures_(std::move(pictures)) {}
  /// @param group  group with the episodes, "" for the root.
  /// @param prefix  text before the number in an episode's name; members with other names are
  ///   rejected.
  /// @param states  dataset or group with the states of an episode, for example "obs".
  /// @param last  the attribute that writers set last. A final episode without this attribute is
  ///   incomplete: it is dropped, and note() reports it.
  void FindEpisodes(const std::string& group, std::string_view prefix, const char* states,
                    const char* last);

  /// Keeps the episodes listed in a mask, in the order of their numbers.
  void KeepMasked(const std::string& mask);

  [[nodiscard]] const Hdf5Reader& file() const noexcept { return file_; }
  /// Returns the path of the first dataset of the controls, whose rows are the episode's steps.
  [[nodiscard]] std::string FirstActions(const std::string& episode) const;
  [[nodiscard]] core::Matrix ReadActions(const std::string& episode, Eigen::Index steps,
                                         const char* count) const;
  /// Reads states from a group of datasets or from a single dataset.
  [[nodiscard]] core::Matrix ReadStates(const std::string& episode, Eigen::Index rows,
                                        const char* count) const;
  /// Returns the attribute `outcome`, which other writers omit.
  [[nodiscard]] std::optional<core::Outcome> Outcome(const std::string& episode) const;

  std::string environment_;

 private:
  /// Reads states, controls and outcome.
  [[nodiscard]] virtual core::Trajectory ReadEpisode(const std::string& episode) const = 0;

  [[nodiscard]] std::vector<std::string> ListEpisodes(const std::string& group,
                                                      std::string_view prefix);
  void LeaveUnfinished(const char* last);

  Hdf5Reader file_;
  std::vector<std::string> pictures_;
  std::string note_;
  std::vector<std::string> episodes_;
  const char* states_ = nullptr;
  core::StateLayout layout_;
  core::StateLayout controls_;
};

}  // namespace dfr::imitation::internal
