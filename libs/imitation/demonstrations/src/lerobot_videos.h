#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "dfr/core/features/features.h"
#include "dfr/core/matrix.h"
#include "video_frames.h"

namespace dfr::imitation::internal {

/// The videos of a LeRobot dataset that are parts of the state. Errors are std::runtime_error
/// naming the file, the feature or episode, the reason and the remedy. Each object belongs to one
/// thread.
class LeRobotVideos {
 public:
  /// @param folder  folder of the dataset.
  explicit LeRobotVideos(std::filesystem::path folder) : folder_(std::move(folder)) {}

  /// Adds a feature of meta/info.json whose dtype is "video". Returns the shape of its pictures.
  core::PictureShape Add(const core::BlockRequest& request, const nlohmann::json& feature);
  /// Finds the files. Call this after all videos are added.
  void Locate(const nlohmann::json& info);

  [[nodiscard]] bool Has(const std::string& name) const { return videos_.contains(name); }
  /// Reads the frames of an episode into the columns from `column` on, one frame per row.
  void Read(const std::string& name, std::int64_t episode, core::Matrix& states,
            Eigen::Index column);

 private:
  /// Part of a video file that contains one episode, in version 3 of the format.
  struct Place {
    std::int64_t chunk = 0;
    std::int64_t file = 0;
    double from_s = 0.0;
    double to_s = 0.0;
  };
  struct Video {
    int camera = 0;
    core::PictureShape frame;
    core::PictureShape picture;
    std::map<std::int64_t, Place> places;  ///< By episode; empty in version 2.
  };
  void ReadPlaces();

  std::filesystem::path folder_;
  std::map<std::string, Video> videos_;
  std::string pattern_;
  double fps_ = 0.0;
  std::int64_t chunk_size_ = 1000;
  bool several_in_a_file_ = false;  ///< True for version 3 of the format.
  VideoFrames frames_;
};

/// Returns the Parquet files in a folder and below it, sorted.
/// @throws std::runtime_error if there is none.
[[nodiscard]] std::vector<std::filesystem::path> ParquetFiles(const std::filesystem::path& folder);

}  // namespace dfr::imitation::internal
