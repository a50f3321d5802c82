#include "dfr/imitation/lerobot.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <map>
#include <new>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/core/files/read_budget.h"
#include "dfr/core/files/read_file.h"
#include "dfr/core/text/format.h"
#include "lerobot_videos.h"
#include "parquet/parquet_file.h"

namespace dfr::imitation {
namespace {

using core::Matrix;
using internal::ParquetColumn;
using internal::ParquetFile;
using nlohmann::json;

constexpr char kAction[] = "action";
constexpr char kEpisode[] = "episode_index";
constexpr char kSuccess[] = "next.success";
constexpr char kFrame[] = "frame_index";

std::filesystem::path InfoFile(const std::filesystem::path& folder) {
  return folder / "meta" / "info.json";
}

[[noreturn]] void Fail(const std::filesystem::path& file, const std::string& reason) {
  throw std::runtime_error(file.string() + ": " + reason);
}

// Returns true if a feature's dtype is numeric or boolean, for any shape.
bool IsNumeric(const json& feature) {
  static constexpr std::string_view kTypes[] = {"float16", "float32", "float64", "bool",
                                                "int8",    "int16",   "int32",   "int64",
                                                "uint8",   "uint16",  "uint32",  "uint64"};
  const auto dtype = feature.find("dtype");
  return dtype != feature.end() && dtype->is_string() &&
         std::find(std::begin(kTypes), std::end(kTypes), dtype->get<std::string>()) !=
             std::end(kTypes);
}

// A range of rows in a row group of a file.
struct Part {
  int file = 0;
  int row_group = 0;
  std::int64_t first = 0;
  std::int64_t count = 0;
};

class LeRobotReader final : public DemonstrationReader {
 public:
  LeRobotReader(std::filesystem::path folder, const std::string& filter_key,
                const std::vector<core::BlockRequest>& pictures)
      : folder_(std::move(folder)), videos_(folder_) {
    const json info = ReadInfo();
    FindFeatures(info, pictures);
    videos_.Locate(info);
    files_ = internal::ParquetFiles(folder_ / "data");
    FindEpisodes(info);
    for (const std::filesystem::path& file : files_) bytes_ += std::filesystem::file_size(file);
    if (!filter_key.empty()) KeepSplit(info, filter_key);
  }

  [[nodiscard]] const core::StateLayout& layout() const noexcept override { return layout_; }
  [[nodiscard]] int control_dim() const noexcept override { return control_dim_; }
  [[nodiscard]] const std::string& environment() const noexcept override { return environment_; }
  [[nodiscard]] int num_episodes() const noexcept override {
    return static_cast<int>(names_.size());
  }
  [[nodiscard]] const std::string& name(int i) const override {
    return names_.at(static_cast<std::size_t>(i));
  }
  [[nodiscard]] const std::string& note() const noexcept override { return note_; }

  [[nodiscard]] core::Trajectory Read(int i) const override {
    const std::vector<Part>& parts = episodes_.at(static_cast<std::size_t>(i));
    std::int64_t frames = 0;
    for (const Part& part : parts) frames += part.count;
    CheckSize(i, frames);
    if (has_frames_) CheckOrder(i, parts);
    core::Trajectory trajectory;
    try {
      trajectory.states.resize(frames, layout_.state_dim());
    } catch (const std::bad_alloc&) {
      Fail(folder_, name(i) + " does not fit into memory; request smaller pictures");
    }
    // The videos come first: the memory of a frame that does not exist is never written.
    for (const auto& block : layout_.blocks) {
      if (!videos_.Has(block.name)) continue;
      videos_.Read(block.name, numbers_[static_cast<std::size_t>(i)], trajectory.states,
                   block.offset);
    }
    for (const auto& block : layout_.blocks) {
      if (videos_.Has(block.name)) continue;
      ReadFeature(i, parts, block.name, block.size, trajectory.states, block.offset);
    }
    Matrix actions(frames, control_dim_);
    ReadFeature(i, parts, kAction, control_dim_, actions, 0);
    trajectory.controls = actions.topRows(frames - 1);
    if (has_success_) {
      Matrix success(frames, 1);
      ReadFeature(i, parts, kSuccess, 1, success, 0);
      if (success(frames - 1, 0) != 0.0) trajectory.outcome = core::Outcome::kCompleted;
    }
    return trajectory;
  }

 private:
  [[nodiscard]] json ReadInfo() {
    const std::filesystem::path file = InfoFile(folder_);
    core::CheckPlainFile(file);
    std::ifstream in(file);
    if (!in) Fail(file, "cannot be opened");
    json info = json::parse(in, nullptr, /*allow_exceptions=*/false);
    if (!info.is_object()) Fail(file, "is not a JSON object");
    const auto version = info.find("codebase_version");
    const std::string text =
        version != info.end() && version->is_string() ? version->get<std::string>() : "";
    if (!text.starts_with("v2.") && !text.starts_with("v3.")) {
      Fail(file, "codebase_version is '" + text +
                     "'; v2.0 to v3.0 can be read. Convert the dataset with LeRobot's scripts");
    }
    if (const auto robot = info.find("robot_type"); robot != info.end() && robot->is_string()) {
      environment_ = robot->get<std::string>();
    }
    return info;
  }

  // Returns the number of entries of a feature with at most one dimension; 0 for other features.
  [[nodiscard]] int SizeOf(const std::string& name, const json& feature) const {
    const auto shape = feature.find("shape");
    if (shape == feature.end() || !shape->is_array()) {
      Fail(InfoFile(folder_), "feature " + name + " has no shape");
    }
    if (shape->size() > 1) return 0;
    if (shape->empty()) return 1;
    constexpr int kMost = 1 << 20;
    const json& size = (*shape)[0];
    if (!size.is_number_integer() || size.get<std::int64_t>() < 1 ||
        size.get<std::int64_t>() > kMost) {
      Fail(InfoFile(folder_), "feature " + name + " has the shape " + shape->dump() + "; 1 to " +
                                  std::to_string(kMost) + " entries are supported");
    }
    return size.get<int>();
  }

  void FindFeatures(const json& info, const std::vector<core::BlockRequest>& pictures) {
    const auto features = info.find("features");
    if (features == info.end() || !features->is_object()) {
      Fail(InfoFile(folder_), "has no features");
    }
    std::string left;
    std::string videos;
    for (const auto& [name, feature] : features->items()) {  // sorted by name
      if (!feature.is_object())
        Fail(InfoFile(folder_), "feature " + name + " is not a JSON object");
      const int size = IsNumeric(feature) ? SizeOf(name, feature) : 0;
      if (name == kSuccess) has_success_ = size == 1;
      if (name == kFrame) has_frames_ = size == 1;
      if (name == kAction) {
        if (size == 0) Fail(InfoFile(folder_), "feature 'action' is not a vector of numbers");
        control_dim_ = size;
      } else if (name == "observation" || name.starts_with("observation.")) {
        const auto asked = std::ranges::find(pictures, name, &core::BlockRequest::name);
        const bool video = feature.value("dtype", json()) == "video";
        if (size > 0) {
          layout_.Add(name, size);
        } else if (asked != pictures.end() && video) {
          layout_.Add(name, videos_.Add(*asked, feature));
        } else {
          left += (left.empty() ? "" : ", ") + name;
        }
        if (video) videos += (videos.empty() ? "" : ", ") + name;
      }
    }
    if (control_dim_ == 0) Fail(InfoFile(folder_), "has no feature 'action'");
    if (layout_.blocks.empty()) {
      Fail(InfoFile(folder_), "has no feature observation.<name> that is a vector of numbers");
    }
    for (const core::BlockRequest& picture : pictures) {
      if (std::ranges::count(layout_.blocks, picture.name, &core::StateLayout::Block::name) > 0) {
        continue;
      }
      throw RequestError(
          InfoFile(folder_).string() + ": " + picture.name +
          " is neither a vector of numbers nor a video; " +
          (videos.empty() ? "the dataset has no video" : "the dataset's videos are " + videos) +
          ". Images in Parquet files are not read: load them in Python "
          "and pass them to Guard.fit");
    }
    if (!left.empty()) note_ = "images and videos are skipped: " + left;
    if (!videos.empty() && pictures.empty()) {
      note_ += "; to read a video, use the feature points:" + videos.substr(0, videos.find(','));
    }
  }

  // The frames of an episode are consecutive rows, which may continue in the next file.
  void FindEpisodes(const json& info) {
    std::map<std::int64_t, std::vector<Part>> found;
    std::int64_t frames = 0;
    std::optional<std::int64_t> last;
    for (int file = 0; file < static_cast<int>(files_.size()); ++file) {
      const ParquetFile& parquet = File(file);
      for (int group = 0; group < parquet.num_row_groups(); ++group) {
        const ParquetColumn column = parquet.Read(group, kEpisode);
        if (static_cast<std::int64_t>(column.values.size()) != column.num_rows()) {
          Fail(files_[static_cast<std::size_t>(file)],
               "column episode_index does not hold one number per row");
        }
        frames += column.num_rows();
        for (std::int64_t row = 0; row < column.num_rows(); ++row) {
          const double value = column.values[static_cast<std::size_t>(row)];
          if (!(value >= 0.0 && value < 1e9) || value != std::floor(value)) {
            Fail(files_[static_cast<std::size_t>(file)],
                 "column episode_index, row " + std::to_string(row) + " is " +
                     std::to_string(value) + ", not an integer from 0 to 1e9");
          }
          const auto episode = static_cast<std::int64_t>(value);
          std::vector<Part>& parts = found[episode];
          if (last != episode && !parts.empty()) {
            Fail(files_[static_cast<std::size_t>(file)],
                 "the frames of episode " + std::to_string(episode) + " are not consecutive");
          }
          last = episode;
          if (parts.empty() || parts.back().file != file || parts.back().row_group != group) {
            parts.push_back({file, group, row, 0});
          }
          ++parts.back().count;
        }
      }
    }
    CheckTotal(info, "total_episodes", static_cast<std::int64_t>(found.size()));
    CheckTotal(info, "total_frames", frames);
    std::size_t short_ones = 0;
    for (auto& [episode, parts] : found) {
      if (parts.size() == 1 && parts[0].count == 1) {
        ++short_ones;
        continue;
      }
      names_.push_back("episode " + std::to_string(episode));
      numbers_.push_back(episode);
      episodes_.push_back(std::move(parts));
    }
    if (episodes_.empty()) Fail(folder_ / "data", "holds no episode of more than one frame");
    if (short_ones > 0) {
      note_ += (note_.empty() ? "" : "; ") + std::string("episodes of one frame are left out: ") +
               std::to_string(short_ones);
    }
  }

  void CheckTotal(const json& info, const char* key, std::int64_t actual) const {
    const auto total = info.find(key);
    if (total == info.end()) return;
    if (!total->is_number_integer() || total->get<std::int64_t>() != actual) {
      Fail(InfoFile(folder_), std::string(key) + " is " + total->dump() +
                                  ", but the files below data hold " + std::to_string(actual) +
                                  ": check that the download is complete");
    }
  }

  // A split is a range of episodes, for example "0:50".
  void KeepSplit(const json& info, const std::string& key) {
    const auto splits = info.find("splits");
    const bool any = splits != info.end() && splits->is_object();
    if (!any || !splits->contains(key)) {
      std::string known;
      if (any) {
        for (const auto& [name, range] : splits->items()) {
          known += (known.empty() ? "" : ", ") + name;
        }
      }
      Fail(InfoFile(folder_),
           "has no split '" + key + "'; " + (known.empty() ? "it has none" : "it has " + known));
    }
    const json& range = (*splits)[key];
    std::int64_t first = 0;
    std::int64_t end = 0;
    bool good = range.is_string();
    if (good) {
      const auto text = range.get<std::string>();
      const char* const stop = text.data() + text.size();
      const auto [colon, error] = std::from_chars(text.data(), stop, first);
      good = error == std::errc() && colon != stop && *colon == ':';
      if (good) {
        const auto [rest, wrong] = std::from_chars(colon + 1, stop, end);
        good = wrong == std::errc() && rest == stop;
      }
    }
    if (!good)
      Fail(InfoFile(folder_),
           "split '" + key + "' is " + range.dump() + ", not a range like \"0:50\"");
    std::size_t kept = 0;
    for (std::size_t i = 0; i < episodes_.size(); ++i) {
      if (numbers_[i] < first || numbers_[i] >= end) continue;
      std::swap(episodes_[kept], episodes_[i]);
      std::swap(numbers_[kept], numbers_[i]);
      std::swap(names_[kept++], names_[i]);
    }
    episodes_.resize(kept);
    numbers_.resize(kept);
    names_.resize(kept);
    if (kept == 0) Fail(InfoFile(folder_), "split '" + key + "' names no episode");
  }

  // Fails if the Parquet files are too small for the episode. The videos hold the other columns.
  void CheckSize(int episode, std::int64_t frames) const {
    std::int64_t columns = control_dim_;
    for (const auto& block : layout_.blocks) columns += videos_.Has(block.name) ? 0 : block.size;
    if (core::ReadBudget(bytes_).Take(static_cast<std::uint64_t>(frames) * sizeof(double),
                                      static_cast<std::uint64_t>(columns))) {
      return;
    }
    const Part& part = episodes_[static_cast<std::size_t>(episode)][0];
    Fail(files_[static_cast<std::size_t>(part.file)],
         name(episode) + " declares " + std::to_string(frames) + " x " + std::to_string(columns) +
             " entries, too many for files of this size");
  }

  // Returns a file, and keeps it open for the next episode, which is often in the same file.
  [[nodiscard]] const ParquetFile& File(int file) const {
    if (open_file_ != file) {
      columns_.clear();
      open_.reset();
      open_.emplace(files_[static_cast<std::size_t>(file)]);
      open_file_ = file;
    }
    return *open_;
  }

  // Returns a column. Caches the columns of the last row group, which holds many episodes in
  // version 3.
  [[nodiscard]] const ParquetColumn& Column(const Part& part, const std::string& name) const {
    const ParquetFile& file = File(part.file);
    if (columns_group_ != part.row_group) columns_.clear();
    columns_group_ = part.row_group;
    const auto found = columns_.find(name);
    if (found != columns_.end()) return found->second;
    return columns_.emplace(name, file.Read(part.row_group, name)).first->second;
  }

  // Checks that the rows of an episode are in chronological order, if the files number the frames.
  void CheckOrder(int episode, const std::vector<Part>& parts) const {
    double before = -1.0;
    Eigen::Index frame = 0;
    for (const Part& part : parts) {
      const std::vector<std::string>& columns = File(part.file).columns();
      if (std::ranges::find(columns, kFrame) == columns.end()) return;
      Matrix index(part.count, 1);
      ReadFeature(episode, {part}, kFrame, 1, index, 0);
      for (Eigen::Index k = 0; k < part.count; ++k, ++frame) {
        if (!(index(k, 0) > before)) {
          FailAt(
              part, episode, kFrame, frame,
              core::Format("is %.0f after %.0f: the rows are not in the order of time; sort them",
                           index(k, 0), before));
        }
        before = index(k, 0);
      }
    }
  }

  void ReadFeature(int episode, const std::vector<Part>& parts, const std::string& name, int size,
                   Matrix& out, Eigen::Index first_column) const {
    Eigen::Index frame = 0;
    for (const Part& part : parts) {
      const ParquetColumn& column = Column(part, name);
      for (std::int64_t row = part.first; row < part.first + part.count; ++row, ++frame) {
        if (row >= column.num_rows()) {
          FailAt(part, episode, name, frame, "is missing");
        }
        const auto r = static_cast<std::size_t>(row);
        const std::int64_t begin = column.offsets[r];
        if (column.offsets[r + 1] - begin != size) {
          FailAt(part, episode, name, frame,
                 "has " + std::to_string(column.offsets[r + 1] - begin) + " entries; " +
                     "meta/info.json states " + std::to_string(size));
        }
        for (int k = 0; k < size; ++k) {
          const double value = column.values[static_cast<std::size_t>(begin + k)];
          if (!core::IsMeasurable(value)) {
            FailAt(part, episode, name, frame,
                   "entry " + std::to_string(k) +
                       (std::isfinite(value) ? core::Format(" is %g, where +-%g is the limit",
                                                            value, core::kLargestEntry)
                                             : std::string(" is missing or not finite")));
          }
          out(frame, first_column + k) = value;
        }
      }
    }
  }

  [[noreturn]] void FailAt(const Part& part, int episode, const std::string& feature,
                           Eigen::Index frame, const std::string& reason) const {
    Fail(files_[static_cast<std::size_t>(part.file)],
         name(episode) + ", " + feature + ", frame " + std::to_string(frame) + ": " + reason);
  }

  std::filesystem::path folder_;
  std::string environment_;
  std::string note_;
  core::StateLayout layout_;
  int control_dim_ = 0;
  bool has_success_ = false;
  bool has_frames_ = false;
  std::vector<std::filesystem::path> files_;
  std::uint64_t bytes_ = 0;  // total size of all files
  std::vector<std::string> names_;
  std::vector<std::int64_t> numbers_;
  std::vector<std::vector<Part>> episodes_;
  mutable internal::LeRobotVideos videos_;
  mutable std::optional<ParquetFile> open_;
  mutable int open_file_ = -1;
  mutable int columns_group_ = -1;
  mutable std::map<std::string, ParquetColumn> columns_;
};

}  // namespace

bool IsLeRobot(const std::filesystem::path& folder) {
  return std::filesystem::exists(InfoFile(folder));
}

std::unique_ptr<DemonstrationReader> OpenLeRobot(const std::filesystem::path& folder,
                                                 const std::string& filter_key,
                                                 const std::vector<core::BlockRequest>& pictures) {
  return std::make_unique<LeRobotReader>(folder, filter_key, pictures);
}

}  // namespace dfr::imitation
