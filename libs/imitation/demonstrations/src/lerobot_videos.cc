#include "lerobot_videos.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <system_error>
#include <utility>

#include "dfr/core/error.h"
#include "dfr/core/files/read_file.h"
#include "dfr/core/text/format.h"
#include "dfr/imitation/demonstrations.h"
#include "parquet/parquet_file.h"

namespace dfr::imitation::internal {
namespace {

// Pixels along the longer side of a picture without a requested size, as for points:NAME.
constexpr int kSide = 32;
constexpr int kMostSide = 1 << 13;
constexpr char kNumberColumn[] = "episode_index";

[[noreturn]] void Refuse(const std::filesystem::path& file, const std::string& problem,
                         const std::string& remedy) {
  throw core::Error(file.string() + ": " + problem, remedy);
}

// Returns the pictures' shape. The feature's names label its sizes: "height", "width", "channel" or
// "channels". Without names, channels come last if the last size is 1 or 3, otherwise first.
std::optional<core::PictureShape> ShapeOfFrames(const nlohmann::json& feature) {
  const auto shape = feature.find("shape");
  if (shape == feature.end() || !shape->is_array() || shape->size() != 3) return std::nullopt;
  std::array<int, 3> sizes{};
  for (std::size_t i = 0; i < sizes.size(); ++i) {
    const nlohmann::json& size = (*shape)[i];
    if (!size.is_number_integer() || size.get<std::int64_t>() < 1 ||
        size.get<std::int64_t>() > kMostSide) {
      return std::nullopt;
    }
    sizes[i] = size.get<int>();
  }
  std::array<std::string, 3> names = {"height", "width", "channels"};
  if (sizes[2] != 1 && sizes[2] != 3) names = {"channels", "height", "width"};
  const auto given = feature.find("names");
  if (given != feature.end() && given->is_array() && given->size() == names.size()) {
    for (std::size_t i = 0; i < names.size(); ++i) {
      if ((*given)[i].is_string()) names[i] = (*given)[i].get<std::string>();
    }
  }
  core::PictureShape found;
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (names[i] == "height") found.height = sizes[i];
    if (names[i] == "width") found.width = sizes[i];
    if (names[i].starts_with("channel")) found.channels = sizes[i];
  }
  const bool good =
      found.height > 0 && found.width > 0 && (found.channels == 1 || found.channels == 3);
  return good ? std::optional(found) : std::nullopt;
}

// Replaces "{name}" and "{name:03d}", as Python's str.format does.
void Fill(std::string& pattern, const std::string& name, const std::string& value) {
  for (std::size_t at = 0; (at = pattern.find("{" + name, at)) != std::string::npos;) {
    const std::size_t end = pattern.find('}', at);
    if (end == std::string::npos) return;
    const std::string format = pattern.substr(at + 1 + name.size(), end - at - 1 - name.size());
    std::string filled = value;
    if (format.size() == 4 && format.starts_with(":0") && format[3] == 'd') {
      const auto digits = static_cast<std::size_t>(std::max(0, format[2] - '0'));
      if (filled.size() < digits) filled.insert(0, digits - filled.size(), '0');
    }
    pattern.replace(at, end + 1 - at, filled);
    at += filled.size();
  }
}

}  // namespace

std::vector<std::filesystem::path> ParquetFiles(const std::filesystem::path& folder) {
  std::error_code error;
  std::vector<std::filesystem::path> paths;
  for (std::filesystem::recursive_directory_iterator it(folder, error), end; it != end;
       it.increment(error)) {
    // Names with a leading dot belong to other tools: macOS creates "._file-000.parquet".
    if (it->path().extension() == ".parquet" && !it->path().filename().string().starts_with('.')) {
      paths.push_back(it->path());
    }
  }
  if (error || paths.empty()) {
    throw std::runtime_error(folder.string() + ": holds no Parquet file");
  }
  std::sort(paths.begin(), paths.end());
  return paths;
}

core::PictureShape LeRobotVideos::Add(const core::BlockRequest& request,
                                      const nlohmann::json& feature) {
  const std::filesystem::path info = folder_ / "meta" / "info.json";
  const std::optional<core::PictureShape> frame = ShapeOfFrames(feature);
  if (!frame) {
    Refuse(
        info,
        "the video " + request.name + " does not have the shape of pictures with 1 or 3 channels",
        "shape and names must be as in [480, 640, 3] and [\"height\", \"width\", \"channels\"]");
  }
  core::PictureShape picture = *frame;
  const int longer = std::max(frame->height, frame->width);
  if (request.height > 0 && request.width > 0) {
    picture.height = request.height;
    picture.width = request.width;
  } else if (longer > kSide) {
    picture.height = std::max(1, frame->height * kSide / longer);
    picture.width = std::max(1, frame->width * kSide / longer);
  }
  if (picture.height > frame->height || picture.width > frame->width) {
    throw RequestError(info.string() + ": " +
                           core::Format("the frames of %s have %d x %d pixels, fewer than %d x %d",
                                        request.name.c_str(), frame->height, frame->width,
                                        picture.height, picture.width),
                       "request a smaller size");
  }
  videos_[request.name] = {static_cast<int>(videos_.size()), *frame, picture, {}};
  return picture;
}

void LeRobotVideos::Locate(const nlohmann::json& info) {
  if (videos_.empty()) return;
  const std::filesystem::path file = folder_ / "meta" / "info.json";
  several_in_a_file_ = info.at("codebase_version").get<std::string>().starts_with("v3.");
  const auto fps = info.find("fps");
  if (fps != info.end() && fps->is_number()) fps_ = fps->get<double>();
  if (!(fps_ > 0.0 && fps_ < 1e6)) {
    Refuse(file, "fps is not a frame rate", "set it to the frame rate of the videos");
  }
  pattern_ = several_in_a_file_
                 ? "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
                 : "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4";
  const auto pattern = info.find("video_path");
  if (pattern != info.end() && pattern->is_string()) pattern_ = pattern->get<std::string>();
  const auto size = info.find("chunks_size");
  if (size != info.end() && size->is_number_integer() && size->get<std::int64_t>() > 0) {
    chunk_size_ = size->get<std::int64_t>();
  }
  if (several_in_a_file_) ReadPlaces();
}

void LeRobotVideos::ReadPlaces() {
  for (const std::filesystem::path& path : ParquetFiles(folder_ / "meta" / "episodes")) {
    const ParquetFile file(path);
    for (int group = 0; group < file.num_row_groups(); ++group) {
      const auto read = [&](const std::string& column) {
        ParquetColumn found = file.Read(group, column);
        if (static_cast<std::int64_t>(found.values.size()) != file.num_rows(group) ||
            !std::ranges::all_of(found.values, [](double v) { return v >= 0.0 && v < 1e9; })) {
          Refuse(path, "column " + column + " does not hold one number >= 0 per row",
                 "check that the download is complete");
        }
        return std::move(found.values);
      };
      const std::vector<double> episodes = read(kNumberColumn);
      for (auto& [name, video] : videos_) {
        const std::string prefix = "videos/" + name + "/";
        const std::vector<double> chunks = read(prefix + "chunk_index");
        const std::vector<double> files = read(prefix + "file_index");
        const std::vector<double> from = read(prefix + "from_timestamp");
        const std::vector<double> to = read(prefix + "to_timestamp");
        for (std::size_t i = 0; i < episodes.size(); ++i) {
          video.places[static_cast<std::int64_t>(episodes[i])] = {
              static_cast<std::int64_t>(chunks[i]), static_cast<std::int64_t>(files[i]), from[i],
              to[i]};
        }
      }
    }
  }
}

void LeRobotVideos::Read(const std::string& name, std::int64_t episode, core::Matrix& states,
                         Eigen::Index column) {
  const Video& video = videos_.at(name);
  VideoClip clip{.file = {},
                 .camera = video.camera,
                 .first = 0,
                 .count = states.rows(),
                 .fps = fps_,
                 .height = video.frame.height,
                 .width = video.frame.width,
                 .out_height = video.picture.height,
                 .out_width = video.picture.width};
  std::string path = pattern_;
  Fill(path, "video_key", name);
  Fill(path, "episode_index", std::to_string(episode));
  Fill(path, "episode_chunk", std::to_string(episode / chunk_size_));
  const std::string which = "episode " + std::to_string(episode) + ", " + name + ": ";
  if (several_in_a_file_) {
    const auto place = video.places.find(episode);
    if (place == video.places.end()) {
      Refuse(folder_ / "meta" / "episodes", which + "is in none of the files",
             "check that the download is complete");
    }
    const auto& [chunk, file, from_s, to_s] = place->second;
    Fill(path, "chunk_index", std::to_string(chunk));
    Fill(path, "file_index", std::to_string(file));
    clip.first = std::llround(from_s * fps_);
    const std::int64_t frames = std::llround(to_s * fps_) - clip.first;
    if (frames < clip.count) {
      Refuse(folder_ / "meta" / "episodes",
             which + core::Format("%.6g s to %.6g s are %lld frames; the episode has %lld states",
                                  from_s, to_s, static_cast<long long>(frames),
                                  static_cast<long long>(clip.count)),
             "check fps in meta/info.json");
    }
  }
  const std::filesystem::path below(path);
  if (below.is_absolute() || std::ranges::count(below, std::filesystem::path("..")) > 0) {
    Refuse(folder_ / "meta" / "info.json", "video_path leads to " + path,
           "it must be a path below the dataset's folder, without ..");
  }
  clip.file = folder_ / below;
  core::CheckPlainFile(clip.file);
  const Eigen::Index size =
      Eigen::Index{video.picture.height} * video.picture.width * video.picture.channels;
  try {
    frames_.Read(clip, states.middleCols(column, size));
  } catch (const std::runtime_error& e) {
    throw std::runtime_error(clip.file.string() + ": " + which + e.what());
  }
}

}  // namespace dfr::imitation::internal
