#include "dfr/imitation/minari.h"

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>
#include <stdexcept>
#include <utility>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/files/atomic_file.h"
#include "dfr/core/files/read_file.h"
#include "episode_io.h"
#include "hdf5/hdf5_file.h"

namespace dfr::imitation {
namespace {

using core::Matrix;
using internal::Hdf5File;
using nlohmann::json;

constexpr char kPrefix[] = "episode_";
constexpr char kPlain[] = "observations";
constexpr char kTotal[] = "total_steps";
constexpr char kEnvironment[] = "environment";  // dfr's key, which accepts any name
constexpr char kSteps[] = "the number of actions";
constexpr char kStates[] = "the number of actions plus one";
// Format version of these files, which Minari 0.5.1 and later read.
constexpr char kMinariVersion[] = "0.5.1";

// Valid names for Minari and Gymnasium. Their loaders reject other names.
bool IsDatasetId(const std::string& id) {
  static const std::regex pattern(R"((?:[-\w][-\w/]*[-\w]+/)?[-\w]+?-v\d{1,9})");
  return std::regex_match(id, pattern);
}
bool IsEnvironmentId(const std::string& id) {
  static const std::regex pattern(R"((?:[\w:-]+/)?[\w:.-]+?(?:-v\d{1,9})?)");
  return std::regex_match(id, pattern);
}

// Returns Gymnasium's EnvSpec as JSON. Gymnasium requires the key additional_wrappers.
std::string EnvironmentSpec(const std::string& id) {
  return json({{"id", id},
               {"entry_point", nullptr},
               {"kwargs", json::object()},
               {"additional_wrappers", json::array()},
               {"vector_entry_point", nullptr}})
      .dump();
}

// Minari stores a space as JSON in a string, with Python's names for infinities.
std::string BoxText(int size, const char* low, const char* high) {
  const auto repeat = [size](const char* value) {
    std::string text = "[";
    for (int k = 0; k < size; ++k) text += std::string(k == 0 ? "" : ", ") + value;
    return text + "]";
  };
  return R"({"type": "Box", "dtype": "float64", "shape": [)" + std::to_string(size) +
         R"(], "low": )" + repeat(low) + R"(, "high": )" + repeat(high) + "}";
}

// Returns the space of the blocks whose names begin with `group`, "" or "goal/". A group of
// datasets is a space of spaces.
std::string SpaceText(const core::StateLayout& layout, const std::string& group) {
  std::string text;
  std::set<std::string> done;
  for (const auto& block : layout.blocks) {
    if (!block.name.starts_with(group)) continue;
    const std::string name =
        block.name.substr(group.size(), block.name.find('/', group.size()) - group.size());
    if (!done.insert(name).second) continue;
    text += (text.empty() ? "" : ", ") + json(name).dump() + ": ";
    text += group + name == block.name ? BoxText(block.size, "-Infinity", "Infinity")
                                       : SpaceText(layout, group + name + "/");
  }
  return R"({"type": "Dict", "subspaces": {)" + text + "}}";
}

std::string ObservationText(const core::StateLayout& layout) {
  return layout.blocks.size() == 1 ? BoxText(layout.state_dim(), "-Infinity", "Infinity")
                                   : SpaceText(layout, "");
}

std::filesystem::path MainFile(const std::filesystem::path& path) {
  for (const char* inside : {"data/main_data.hdf5", "main_data.hdf5"}) {
    if (std::filesystem::exists(path / inside)) return path / inside;
  }
  if (std::filesystem::is_directory(path)) {
    throw std::runtime_error(
        path.string() +
        ": has neither data/main_data.hdf5 (Minari) nor meta/info.json (LeRobot): name the folder "
        "that has one of them, or a robomimic file");
  }
  return path;
}

class MinariReader final : public internal::EpisodeReader {
 public:
  MinariReader(const std::filesystem::path& path, std::vector<std::string> pictures)
      : EpisodeReader(internal::Hdf5Reader(path), std::move(pictures)) {
    FindEpisodes("", kPrefix, kPlain, kTotal);
    ReadMetadata(path.parent_path() / "metadata.json");
  }

 private:
  [[nodiscard]] core::Trajectory ReadEpisode(const std::string& episode) const override {
    const std::string actions = FirstActions(episode);
    const Eigen::Index steps = file().Shape(actions).at(0);
    if (steps < 1) file().Fail(actions, "is empty");
    if (const auto total = file().IntegerAttribute(episode, kTotal);
        total.value_or(steps) != steps) {
      file().Fail(episode, "total_steps is " + std::to_string(*total) + ", but there are " +
                               std::to_string(steps) + " actions");
    }
    core::Trajectory trajectory;
    trajectory.states = ReadStates(episode, steps + 1, kStates);
    trajectory.controls = ReadActions(episode, steps, kSteps);
    trajectory.outcome = OutcomeOf(episode, steps);
    return trajectory;
  }

  [[nodiscard]] core::Outcome OutcomeOf(const std::string& episode, Eigen::Index steps) const {
    if (const auto outcome = Outcome(episode)) return *outcome;
    // infos/success has an entry for the reset before the entries of the steps.
    const std::string success = episode + "/infos/success";
    Matrix values;
    if (file().Exists(success)) values = file().Read(success);
    const std::string terminations = episode + "/terminations";
    if (values.size() == 0 && file().Exists(terminations)) {
      values = internal::ReadRows(file(), terminations, steps, kSteps);
    }
    const bool completed = values.size() > 0 && values(values.rows() - 1, 0) != 0.0;
    return completed ? core::Outcome::kCompleted : core::Outcome::kHalted;
  }

  // Reads the environment's name. Files without metadata have none.
  void ReadMetadata(const std::filesystem::path& path) {
    core::CheckPlainFile(path);
    std::ifstream in(path);
    if (!in) return;
    const json metadata = json::parse(in, nullptr, /*allow_exceptions=*/false);
    if (!metadata.is_object()) throw std::runtime_error(path.string() + ": is not a JSON object");
    const auto text = [&path](const json& object, const char* key, const char* otherwise) {
      const auto found = object.find(key);
      if (found == object.end()) return std::string(otherwise);
      if (!found->is_string()) {
        throw std::runtime_error(path.string() + ": " + key + " is not a string");
      }
      return found->get<std::string>();
    };
    const auto total = metadata.find("total_episodes");
    if (note().empty() && total != metadata.end() && total->is_number_integer() &&
        total->get<std::int64_t>() > num_episodes()) {
      SetNote(path.string() + " declares " + total->dump() + " episodes, but the file holds " +
              std::to_string(num_episodes()) + ": check that the download is complete");
    }
    const std::string format = text(metadata, "data_format", "hdf5");
    if (format != "hdf5") {
      throw std::runtime_error(path.string() + ": data_format is '" + format +
                               "'; only hdf5 can be read");
    }
    if (const auto spec = metadata.find("env_spec"); spec != metadata.end() && spec->is_string()) {
      const json environment = json::parse(spec->get<std::string>(), nullptr, false);
      if (environment.is_object()) environment_ = text(environment, "id", "");
    }
    if (environment_.empty()) environment_ = text(metadata, kEnvironment, "");
    if (environment_.empty()) environment_ = text(metadata, "dataset_id", "");
  }
};

}  // namespace

class MinariWriter::File {
 public:
  File(const std::filesystem::path& folder, std::string dataset_id, core::StateLayout layout,
       int control_dim, std::string environment)
      : folder_(folder / "data"),
        layout_(std::move(layout)),
        control_dim_(control_dim),
        dataset_id_(std::move(dataset_id)),
        environment_(std::move(environment)),
        file_(Make()) {
    WriteMetadata();
  }

  void Append(const core::Trajectory& trajectory) {
    internal::CheckTrajectory(trajectory, layout_.state_dim(), control_dim_, episodes_);
    const auto steps = static_cast<std::size_t>(trajectory.controls.rows());
    const std::string episode = Hdf5File::kNewGroup;
    const bool completed = trajectory.outcome == core::Outcome::kCompleted;
    std::vector<double> rewards(steps, 0.0);
    std::vector<bool> terminations(steps, false);
    std::vector<bool> truncations(steps, false);
    rewards.back() = completed ? 1.0 : 0.0;
    terminations.back() = completed;
    truncations.back() = !completed;

    file_.CreateNewGroup();
    if (layout_.blocks.size() == 1) {
      file_.WriteGrowable(episode + "/" + kPlain, trajectory.states);
    } else {
      const std::string group = episode + "/" + kPlain;
      file_.CreateGroup(group);
      for (const auto& block : layout_.blocks) {
        std::string path = group;
        path += "/" + block.name;
        file_.WriteGrowable(path, Matrix(trajectory.states.middleCols(block.offset, block.size)));
        file_.SetAttribute(path, "offset", block.offset);
      }
    }
    file_.WriteGrowable(episode + "/actions", trajectory.controls);
    file_.WriteGrowable(episode + "/rewards", rewards);
    file_.WriteGrowable(episode + "/terminations", terminations);
    file_.WriteGrowable(episode + "/truncations", truncations);
    file_.CreateGroup(episode + "/infos");
    file_.SetAttribute(episode, "id", episodes_);
    file_.SetAttribute(episode, "seed", static_cast<std::int64_t>(trajectory.seed));
    file_.SetAttribute(episode, "outcome", std::string(core::Name(trajectory.outcome)));
    file_.SetAttribute(episode, kTotal, static_cast<std::int64_t>(steps));
    file_.Flush();  // flushes all data that the new name will refer to
    file_.LinkNewGroup(kPrefix + std::to_string(episodes_));
    file_.Flush();
    ++episodes_;
    total_ += static_cast<std::int64_t>(steps);
    WriteMetadata();
  }

  [[nodiscard]] int num_episodes() const noexcept { return episodes_; }

 private:
  Hdf5File Make() const {
    std::error_code error;
    std::filesystem::create_directories(folder_, error);
    if (error) {
      throw std::runtime_error(folder_.string() + ": cannot be created: " + error.message());
    }
    return Hdf5File::Create(folder_ / "main_data.hdf5", /*track_order=*/true);
  }

  // Replaces the file as a whole: readers never see an incomplete file.
  void WriteMetadata() const {
    std::error_code ignored;
    const auto bytes = std::filesystem::file_size(folder_ / "main_data.hdf5", ignored);
    json metadata = {{"total_episodes", episodes_},
                     {"total_steps", total_},
                     {"dataset_size", std::round(static_cast<double>(bytes) / 1e5) / 10.0},  // MB
                     {"data_format", "hdf5"},
                     {"jpeg_encoding", false},
                     {"dataset_id", dataset_id_},
                     {"minari_version", kMinariVersion},
                     {"observation_space", ObservationText(layout_)},
                     {"action_space", BoxText(control_dim_, "-1.0", "1.0")}};
    // Minari reads datasets without an environment, but rejects invalid names of environments.
    if (IsEnvironmentId(environment_)) metadata["env_spec"] = EnvironmentSpec(environment_);
    if (!environment_.empty()) metadata[kEnvironment] = environment_;
    core::ReplaceFile(folder_ / "metadata.json",
                      metadata.dump(2, ' ', false, json::error_handler_t::replace) + "\n");
  }

  std::filesystem::path folder_;
  core::StateLayout layout_;
  int control_dim_;
  std::string dataset_id_;
  std::string environment_;
  Hdf5File file_;
  int episodes_ = 0;
  std::int64_t total_ = 0;
};

MinariWriter::MinariWriter(const std::filesystem::path& folder, const std::string& dataset_id,
                           core::StateLayout layout, int control_dim,
                           const std::string& environment) {
  internal::CheckLayout(layout, control_dim);
  DFR_THROW_UNLESS(IsDatasetId(dataset_id),
                   "'" << dataset_id << "' is not the id of a Minari dataset: it must be "
                       << "<namespace>/<name>-v<number> of letters, digits, - and _");
  file_ = std::make_unique<File>(folder, dataset_id, std::move(layout), control_dim, environment);
}

MinariWriter::MinariWriter(MinariWriter&&) noexcept = default;
MinariWriter& MinariWriter::operator=(MinariWriter&&) noexcept = default;
MinariWriter::~MinariWriter() = default;

void MinariWriter::Append(const core::Trajectory& trajectory) { file_->Append(trajectory); }

int MinariWriter::num_episodes() const noexcept { return file_->num_episodes(); }

std::unique_ptr<DemonstrationReader> OpenMinari(const std::filesystem::path& path,
                                                const std::vector<std::string>& pictures) {
  return std::make_unique<MinariReader>(MainFile(path), pictures);
}

}  // namespace dfr::imitation
