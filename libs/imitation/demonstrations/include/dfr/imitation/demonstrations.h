#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "dfr/core/error.h"
#include "dfr/core/features/features.h"
#include "dfr/core/files/provenance.h"
#include "dfr/core/trajectory.h"

namespace dfr::imitation {

/// Demonstrations of a supervisor.
struct DemonstrationSet {
  core::StateLayout layout;  ///< Layout of the trajectories' states.
  int control_dim = 0;
  std::string environment;  ///< Name of the plant or task.
  std::vector<core::Trajectory> trajectories;
  int discarded = 0;  ///< Number of demonstrations that violated a constraint and were left out.
  std::string note;   ///< DemonstrationReader::note() of the file.
  core::Provenance provenance = {};
};

/// Reader of a demonstration file, one episode at a time. Needs memory only for the longest
/// episode. Each object belongs to one thread.
class DemonstrationReader {
 public:
  virtual ~DemonstrationReader() = default;

  [[nodiscard]] virtual const core::StateLayout& layout() const noexcept = 0;
  [[nodiscard]] virtual int control_dim() const noexcept = 0;
  [[nodiscard]] virtual const std::string& environment() const noexcept = 0;
  /// Returns DemonstrationSet::discarded; 0 if the file does not record it.
  [[nodiscard]] virtual int discarded() const noexcept { return 0; }
  /// Returns the origin of the data; unknown if the file does not record it.
  [[nodiscard]] virtual const core::Provenance& provenance() const noexcept;
  [[nodiscard]] virtual int num_episodes() const noexcept = 0;
  /// Returns a note about the reading of the file, for example "images and videos are skipped:
  /// ..."; can be empty.
  [[nodiscard]] virtual const std::string& note() const noexcept;

  /// Returns the name of episode i in the file, for example "data/demo_7". i is in [0,
  /// num_episodes()).
  [[nodiscard]] virtual const std::string& name(int i) const = 0;
  /// @throws std::runtime_error naming the file, episode, dataset and reason.
  [[nodiscard]] virtual core::Trajectory Read(int i) const = 0;
};

/// A requested picture that the demonstrations do not have, or not in the requested size.
class RequestError : public core::Error {
 public:
  using core::Error::Error;
};

/// Opens demonstrations in robomimic's, Minari's (see minari.h) or LeRobot's (see lerobot.h)
/// format. Detects the format.
/// @param filter_key  reads only the episodes under this key, for example robomimic's mask/train or
///   a split of LeRobot; empty: all.
/// @param pictures  datasets or videos that must exist. Pictures among them become parts of the
///   state: datasets (steps, height, width) or (steps, height, width, 1 or 3 channels), and
///   LeRobot's videos. Other pictures are skipped. The size of a request applies only to videos.
/// @throws RequestError naming the file and the picture; std::runtime_error naming the file and
///   reason, also if the key does not exist.
[[nodiscard]] std::unique_ptr<DemonstrationReader> OpenDemonstrations(
    const std::filesystem::path& path, const std::string& filter_key = "",
    const std::vector<core::BlockRequest>& pictures = {});
/// Returns a request for each picture of a layout, with the picture's size.
[[nodiscard]] std::vector<core::BlockRequest> PictureRequests(const core::StateLayout& layout);
/// Reads all demonstrations of a file or dataset.
[[nodiscard]] DemonstrationSet LoadDemonstrations(const std::filesystem::path& path);

// robomimic's HDF5 format: group data/demo_<i> per episode of N controls, with datasets
//   actions (N x control_dim, within [-1, 1]),  states (N x state_dim),
//   obs/<block> and next_obs/<block> (N x block size) for each block of the layout,
//   rewards (N; 1 at the step that completes the task, else 0) and dones (N; 1 at the same step).
// The last state is the last row of next_obs. dfr adds attributes that other readers ignore: `seed`
// and `outcome` of each demo, `offset` of each obs dataset (its position in the state), `discarded`
// of data and, if known, its `provenance` (core::ToText()).
//
// The functions below throw std::runtime_error naming the file, episode, dataset and reason.
// libhdf5 reads files in a separate process because it does not validate them. It writes in this
// process, from one thread at a time.

/// Writes episodes one at a time. Flushes each episode before naming it: if the process is killed,
/// the file keeps all episodes appended before.
class RobomimicWriter {
 public:
  /// Creates the file, replacing any existing one.
  /// @param model_xml  the simulation's model, stored with each episode as robomimic requires.
  RobomimicWriter(const std::filesystem::path& path, core::StateLayout layout, int control_dim,
                  const std::string& environment, std::string model_xml = "");
  RobomimicWriter(RobomimicWriter&&) noexcept;
  RobomimicWriter& operator=(RobomimicWriter&&) noexcept;
  ~RobomimicWriter();

  /// @throws std::invalid_argument if the trajectory is empty, has other dimensions, an entry that
  ///   is not finite or a control beyond [-1, 1]. Writes nothing in that case.
  void Append(const core::Trajectory& trajectory);

  /// Sets the origin of all episodes; call once. @throws std::invalid_argument as core::ToText().
  void SetProvenance(const core::Provenance& provenance);

  /// Copies the origin and the number of discarded episodes of another file; call once.
  void CopyOrigin(const DemonstrationReader& from);

  /// Adds `episodes` >= 0 to the number of discarded episodes, with one write to the file.
  void CountDiscarded(int episodes = 1);

  [[nodiscard]] int num_episodes() const noexcept;

 private:
  class File;
  std::unique_ptr<File> file_;
};

/// Writes all demonstrations of a set.
void SaveRobomimic(const DemonstrationSet& demonstrations, const std::filesystem::path& path,
                   const std::string& model_xml = "");

/// Opens a robomimic file, written by any program. Episodes are in the order of their numbers.
/// - State: all vector-valued obs datasets, sorted by `offset` if all have one, otherwise by name,
///   and concatenated. Datasets of more than two dimensions (images) are skipped except `pictures`.
/// - Without next_obs, the file lacks the state after the last control, and that control is
///   dropped.
/// - An incomplete episode at the end (its writer was killed) is dropped, and note() reports it.
/// - Without `outcome`, an episode is completed if its attribute `success` is not zero (Isaac Lab)
///   or, without that attribute, if the last entry of dones is not zero.
/// - `filter_key` keeps the episodes listed in mask/FILTER_KEY.
[[nodiscard]] std::unique_ptr<DemonstrationReader> OpenRobomimic(
    const std::filesystem::path& path, const std::string& filter_key = "",
    const std::vector<std::string>& pictures = {});
/// Reads all demonstrations of a file.
[[nodiscard]] DemonstrationSet LoadRobomimic(const std::filesystem::path& path);

}  // namespace dfr::imitation
