#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "dfr/core/features.h"
#include "dfr/core/provenance.h"
#include "dfr/core/trajectory.h"

namespace dfr::imitation {

/// What a supervisor has shown.
struct DemonstrationSet {
  core::StateLayout layout;  ///< Layout of the trajectories' states.
  int control_dim = 0;
  std::string environment;  ///< The name of the plant or task.
  std::vector<core::Trajectory> trajectories;
  int discarded = 0;  ///< Demonstrations that violated a constraint and are not among these.
  std::string note;   ///< DemonstrationReader::note() of the file.
  core::Provenance provenance = {};
};

/// A file of demonstrations that is read one episode at a time: it takes the memory of its longest
/// episode, whatever its size. One object belongs to one thread.
class DemonstrationReader {
 public:
  virtual ~DemonstrationReader() = default;

  [[nodiscard]] virtual const core::StateLayout& layout() const noexcept = 0;
  [[nodiscard]] virtual int control_dim() const noexcept = 0;
  [[nodiscard]] virtual const std::string& environment() const noexcept = 0;
  /// DemonstrationSet::discarded, where the file says so.
  [[nodiscard]] virtual int discarded() const noexcept { return 0; }
  /// Unknown where the file does not say.
  [[nodiscard]] virtual const core::Provenance& provenance() const noexcept;
  [[nodiscard]] virtual int num_episodes() const noexcept = 0;
  /// What a user should know of how the file is read: "images and videos are left alone: ..."; may
  /// be empty.
  [[nodiscard]] virtual const std::string& note() const noexcept;

  /// What the file calls episode i, in [0, num_episodes()): "data/demo_7".
  [[nodiscard]] virtual const std::string& name(int i) const = 0;
  /// @throws std::runtime_error naming file, episode, dataset and reason.
  [[nodiscard]] virtual core::Trajectory Read(int i) const = 0;
};

/// Opens demonstrations of robomimic, Minari (see minari.h) or LeRobot (see lerobot.h), whichever
/// it is.
/// @param filter_key  only the episodes that this key names, as robomimic's mask/train or a split
/// of
///   LeRobot does; empty: all.
/// @throws std::runtime_error naming file and reason, among them a key that does not exist.
[[nodiscard]] std::unique_ptr<DemonstrationReader> OpenDemonstrations(
    const std::filesystem::path& path, const std::string& filter_key = "");
/// Reads all of it.
[[nodiscard]] DemonstrationSet LoadDemonstrations(const std::filesystem::path& path);

// robomimic's HDF5 format: group data/demo_<i> per episode of N controls, with datasets
//   actions (N x control_dim, within [-1, 1]),  states (N x state_dim),
//   obs/<block> and next_obs/<block> (N x block size) for each block of the layout,
//   rewards (N; 1 at the step that completes the task, else 0) and dones (N; 1 at the same step).
// The last state is the last row of next_obs. On top of the format, each demo has the attributes
// `seed` and `outcome`, each obs dataset its `offset` within the state, and data has `discarded`
// and, where it is known, `provenance` (core::ToText()); other readers ignore them.
//
// The functions below throw std::runtime_error naming file, episode, dataset and reason. Files are
// read by libhdf5 in a process of its own, because it trusts what it reads; they are written in
// this one, from one thread at a time.

/// Writes episodes as they come. Each is flushed and only then named: a process that is killed at
/// any moment leaves a file with all episodes appended before.
class RobomimicWriter {
 public:
  /// Creates the file, replacing any.
  /// @param model_xml  the simulation's model, kept with each episode as robomimic wants it.
  RobomimicWriter(const std::filesystem::path& path, core::StateLayout layout, int control_dim,
                  const std::string& environment, std::string model_xml = "");
  RobomimicWriter(RobomimicWriter&&) noexcept;
  RobomimicWriter& operator=(RobomimicWriter&&) noexcept;
  ~RobomimicWriter();

  /// @throws std::invalid_argument if the trajectory is empty, has other dimensions, an entry that
  ///   is not finite or a control beyond [-1, 1]; nothing is written then.
  void Append(const core::Trajectory& trajectory);

  /// Where all of them are from; said once. @throws std::invalid_argument as core::ToText().
  void SetProvenance(const core::Provenance& provenance);

  /// Counts one that was left out.
  void CountDiscarded();

  [[nodiscard]] int num_episodes() const noexcept;

 private:
  class File;
  std::unique_ptr<File> file_;
};

/// Writes a whole set.
void SaveRobomimic(const DemonstrationSet& demonstrations, const std::filesystem::path& path,
                   const std::string& model_xml = "");

/// Opens a file written here or by others. Episodes come in the order of their numbers. A state is
/// all vector-valued obs datasets one after another, by `offset` where all have one, else by name;
/// those of more than two dimensions (images) are left out. Without next_obs the state after the
/// last control is not in the file, and that control is left out. An episode at the end that was
/// cut off with its writer is left out, which note() says. Without `outcome`, an episode completed
/// if its attribute `success` is not zero, as Isaac Lab has it, or, without that, its last done is
/// 1. A `filter_key` leaves the episodes that mask/FILTER_KEY names.
[[nodiscard]] std::unique_ptr<DemonstrationReader> OpenRobomimic(
    const std::filesystem::path& path, const std::string& filter_key = "");
/// Reads all of it.
[[nodiscard]] DemonstrationSet LoadRobomimic(const std::filesystem::path& path);

}  // namespace dfr::imitation
