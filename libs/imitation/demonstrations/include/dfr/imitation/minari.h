#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "dfr/core/features.h"
#include "dfr/core/trajectory.h"
#include "dfr/imitation/demonstrations.h"

namespace dfr::imitation {

// Minari's format: a folder DATASET with data/main_data.hdf5 and data/metadata.json. Group
// episode_<i> of T controls has
//   observations ((T + 1) x state_dim, or a group of such datasets),  actions (T x control_dim),
//   rewards (T),  terminations and truncations (T truth values),  infos (a group).
// On top of the format, episodes have the attribute `outcome`, and datasets of a group of
// observations their `offset` within the state; other readers ignore them.
//
// The functions below throw std::runtime_error naming file, episode, dataset and reason. libhdf5
// reads in a process of its own and writes in this one, as for robomimic's files.

/// Writes episodes as they come. Each is flushed, and counted in metadata.json afterwards. A kill
/// loses nothing unless it falls within the few writes that name an episode: where that matters,
/// record with RobomimicWriter, which has a second list of names, and convert.
class MinariWriter {
 public:
  /// Creates the folder, replacing its data.
  /// @param folder  the dataset's, ROOT/NAMESPACE/NAME-vVERSION for Minari to find it.
  /// @param dataset_id  NAMESPACE/NAME-vVERSION, which Minari demands; NAMESPACE/ may be missing.
  /// @param layout  with one block: plain observations; with several: one dataset each.
  /// @param environment  where it is a name that Gymnasium accepts, NAME-vVERSION, the dataset's
  ///   env_spec; others are kept under a key of their own, because Minari refuses them.
  MinariWriter(const std::filesystem::path& folder, const std::string& dataset_id,
               core::StateLayout layout, int control_dim, const std::string& environment);
  MinariWriter(MinariWriter&&) noexcept;
  MinariWriter& operator=(MinariWriter&&) noexcept;
  ~MinariWriter();

  /// Completed ends in a termination with reward 1, everything else in a truncation.
  /// @throws std::invalid_argument as RobomimicWriter::Append() does; nothing is written then.
  void Append(const core::Trajectory& trajectory);

  [[nodiscard]] int num_episodes() const noexcept;

 private:
  class File;
  std::unique_ptr<File> file_;
};

/// Writes a whole set.
void SaveMinari(const DemonstrationSet& demonstrations, const std::filesystem::path& folder,
                const std::string& dataset_id);

/// Opens a dataset's folder, its data folder, or main_data.hdf5. The state is all vector-valued
/// observations one after another, as for robomimic; plain observations are one block
/// "observations". Without `outcome`, an episode completed if the last entry of infos/success is
/// not zero, or, without that, if its last termination is true.
[[nodiscard]] std::unique_ptr<DemonstrationReader> OpenMinari(const std::filesystem::path& path);

}  // namespace dfr::imitation
