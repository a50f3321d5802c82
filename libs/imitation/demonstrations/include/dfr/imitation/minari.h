#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "dfr/core/features/features.h"
#include "dfr/core/trajectory.h"
#include "dfr/imitation/demonstrations.h"

namespace dfr::imitation {

// Minari's format: a folder DATASET with data/main_data.hdf5 and data/metadata.json. Group
// episode_<i> of T controls has
//   observations ((T + 1) x state_dim, or a group of such datasets),  actions (T x control_dim),
//   rewards (T),  terminations and truncations (T Boolean values),  infos (a group).
// dfr adds attributes that other readers ignore: `outcome` of each episode and `offset` of each
// dataset in a group of observations (its position in the state).
//
// The functions below throw std::runtime_error naming the file, episode, dataset and reason.
// libhdf5 reads in a separate process and writes in this one, as for robomimic's files.

/// Writes episodes one at a time. Flushes each episode, then counts it in metadata.json. Only a
/// kill during the few writes that name an episode loses data. To avoid this, record with
/// RobomimicWriter, which keeps a second list of names, and convert.
class MinariWriter {
 public:
  /// Creates the folder, replacing its data.
  /// @param folder  the dataset's folder; Minari finds ROOT/NAMESPACE/NAME-vVERSION.
  /// @param dataset_id  NAMESPACE/NAME-vVERSION, as Minari requires; NAMESPACE/ is optional.
  /// @param layout  one block: plain observations; several blocks: one dataset each.
  /// @param environment  stored as the dataset's env_spec if it is a valid name for Gymnasium,
  ///   NAME-vVERSION. Minari rejects other names, which are stored under a separate key.
  MinariWriter(const std::filesystem::path& folder, const std::string& dataset_id,
               core::StateLayout layout, int control_dim, const std::string& environment);
  MinariWriter(MinariWriter&&) noexcept;
  MinariWriter& operator=(MinariWriter&&) noexcept;
  ~MinariWriter();

  /// Appends an episode. A completed episode ends in a termination with reward 1, any other episode
  /// in a truncation.
  /// @throws std::invalid_argument as RobomimicWriter::Append(). Writes nothing in that case.
  void Append(const core::Trajectory& trajectory);

  [[nodiscard]] int num_episodes() const noexcept;

 private:
  class File;
  std::unique_ptr<File> file_;
};

/// Opens a dataset's folder, its data folder, or main_data.hdf5. The state is the concatenation of
/// all vector-valued observations, as for robomimic. Plain observations are one block
/// "observations". Without `outcome`, an episode is completed if the last entry of infos/success is
/// not zero or, without infos/success, if its last termination is true.
[[nodiscard]] std::unique_ptr<DemonstrationReader> OpenMinari(
    const std::filesystem::path& path, const std::vector<std::string>& pictures = {});

}  // namespace dfr::imitation
