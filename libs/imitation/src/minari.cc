#include "dfr/imitation/minari.h"

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "dfr/core/contract.h"
#include "episode_io.h"
#include "hdf5_file.h"

namespace dfr::imitation {
namespace {

using core::Matrix;
using core::Outcome;
using internal::Hdf5File;
using nlohmann::json;

constexpr char kPrefix[] = "episode_";
constexpr char kPlain[] = "observations";
constexpr char kSteps[] = "the number of actions";
constexpr char kStates[] = "that of actions plus one";
// The version of the format written here.
constexpr char kMinariVersion[] = "0.5.1";

// Minari keeps a space as JSON inside a string, with Python's names for infinities.
std::string BoxText(int size, const char* low, const char* high) {
  const auto repeat = [size](const char* value) {
    std::string text = "[";
    for (int k = 0; k < size; ++k) text += std::string(k == 0 ? "" : ", ") + value;
    return text + "]";
  };
  return R"({"type": "Box", "dtype": "float64", "shape": [)" + std::to_string(size) +
         R"(], "low": )" + repeat(low) + R"(, "high": )" + repeat(high) + "}";
}

std::string ObservationText(const core::StateLayout& layout) {
  if (layout.blocks.size() == 1) return BoxText(layout.state_dim(), "-Infinity", "Infinity");
  std::string text = R"({"type": "Dict", "subspaces": {)";
  for (std::size_t b = 0; b < layout.blocks.size(); ++b) {
    text += b == 0 ? "" : ", ";
    text += json(layout.blocks[b].name).dump() + ": " +
            BoxText(layout.blocks[b].size, "-Infinity", "Infinity");
  }
  return text + "}}";
}

std::filesystem::path MainFile(const std::filesystem::path& path) {
  for (const char* inside : {"data/main_data.hdf5", "main_data.hdf5"}) {
    if (std::filesystem::exists(path / inside)) return path / inside;
  }
  if (std::filesystem::is_directory(path)) {
    throw std::runtime_error(path.string() +
                             ": has no data/main_data.hdf5: this is no Minari dataset");
  }
  return path;
}

class MinariReader final : public DemonstrationReader {
 public:
  explicit MinariReader(const std::filesystem::path& path)
      : file_(Hdf5File::Open(path)), episodes_(internal::NumberedMembers(file_, "", kPrefix)) {
    if (episodes_.empty()) file_.Fail("/", "holds no episode");
    layout_ = StateLayoutOf(episodes_[0]);
    controls_ = ControlLayoutOf(episodes_[0]);
    ReadMetadata(path.parent_path() / "metadata.json");
  }

  [[nodiscard]] const core::StateLayout& layout() const noexcept override { return layout_; }
  [[nodiscard]] int control_dim() const noexcept override { return controls_.state_dim(); }
  [[nodiscard]] const std::string& environment() const noexcept override { return environment_; }
  [[nodiscard]] int num_episodes() const noexcept override {
    return static_cast<int>(episodes_.size());
  }
  [[nodiscard]] const std::string& name(int i) const override {
    return episodes_.at(static_cast<std::size_t>(i));
  }

  [[nodiscard]] core::Trajectory Read(int i) const override {
    const std::string& episode = name(i);
    if (StateLayoutOf(episode) != layout_) {
      file_.Fail(episode + "/observations", "has other datasets or sizes than the first episode's");
    }
    if (ControlLayoutOf(episode) != controls_) {
      file_.Fail(episode + "/actions", "has other datasets or sizes than the first episode's");
    }
    const std::string first_action = WithinEpisode(episode, "actions", controls_);
    const Eigen::Index steps = file_.Shape(first_action).at(0);
    if (steps < 1) file_.Fail(first_action, "is empty");
    if (const auto total = file_.IntegerAttribute(episode, "total_steps");
        total.value_or(steps) != steps) {
      file_.Fail(episode, "total_steps is " + std::to_string(*total) + ", but there are " +
                              std::to_string(steps) + " actions");
    }
    core::Trajectory trajectory;
    trajectory.states = ReadPart(episode, kPlain, layout_, steps + 1, kStates);
    trajectory.controls = ReadPart(episode, "actions", controls_, steps, kSteps);
    trajectory.seed =
        static_cast<std::uint64_t>(file_.IntegerAttribute(episode, "seed").value_or(0));
    trajectory.outcome = OutcomeOf(episode, steps);
    return trajectory;
  }

 private:
  // Datasets of a group, or the one dataset that stands in its place.
  [[nodiscard]] core::StateLayout PartLayout(const std::string& episode, const char* part) const {
    const std::string path = episode + "/" + part;
    if (!file_.Exists(path)) file_.Fail(path, "does not exist");
    if (file_.IsGroup(path)) return internal::ReadLayout(file_, path);
    const std::vector<std::int64_t> shape = file_.Shape(path);
    if (shape.empty() || shape.size() > 2 || (shape.size() == 2 && shape[1] < 1)) {
      file_.Fail(path, "has " + std::to_string(shape.size()) +
                           " dimensions; vectors are needed, one row per step");
    }
    core::StateLayout layout;
    layout.Add(part, shape.size() == 2 ? static_cast<int>(shape[1]) : 1);
    return layout;
  }
  [[nodiscard]] core::StateLayout StateLayoutOf(const std::string& episode) const {
    return PartLayout(episode, kPlain);
  }
  [[nodiscard]] core::StateLayout ControlLayoutOf(const std::string& episode) const {
    return PartLayout(episode, "actions");
  }
  [[nodiscard]] std::string WithinEpisode(const std::string& episode, const char* part,
                                          const core::StateLayout& layout) const {
    std::string path = episode + "/" + part;
    if (file_.IsGroup(path)) path += "/" + layout.blocks[0].name;
    return path;
  }
  [[nodiscard]] Matrix ReadPart(const std::string& episode, const char* part,
                                const core::StateLayout& layout, Eigen::Index rows,
                                const char* count) const {
    const std::string path = episode + "/" + part;
    return internal::ReadBlocks(file_, file_.IsGroup(path) ? path : episode, layout, rows, count);
  }

  [[nodiscard]] Outcome OutcomeOf(const std::string& episode, Eigen::Index steps) const {
    if (const auto name = file_.TextAttribute(episode, "outcome")) {
      const std::optional<Outcome> outcome = internal::ParseOutcome(*name);
      if (!outcome) file_.Fail(episode, "outcome '" + *name + "' is unknown");
      return *outcome;
    }
    // Infos have an entry for the reset, too.
    const std::string success = episode + "/infos/success";
    if (file_.Exists(success)) {
      const Matrix values = file_.Read(success);
      if (values.size() > 0) {
        return values(values.rows() - 1, 0) != 0.0 ? Outcome::kCompleted : Outcome::kHalted;
      }
    }
    const std::string terminations = episode + "/terminations";
    if (!file_.Exists(terminations)) return Outcome::kHalted;
    const Matrix values = internal::ReadRows(file_, terminations, steps, kSteps);
    return values(steps - 1, 0) != 0.0 ? Outcome::kCompleted : Outcome::kHalted;
  }

  // The environment's name; a file without metadata has none.
  void ReadMetadata(const std::filesystem::path& path) {
    std::ifstream in(path);
    if (!in) return;
    const json metadata = json::parse(in, nullptr, /*allow_exceptions=*/false);
    if (!metadata.is_object()) throw std::runtime_error(path.string() + ": is not a JSON object");
    const auto text = [&path](const json& object, const char* key, const char* otherwise) {
      const auto found = object.find(key);
      if (found == object.end()) return std::string(otherwise);
      if (!found->is_string()) {
        throw std::runtime_error(path.string() + ": " + key + " is not a text");
      }
      return found->get<std::string>();
    };
    const std::string format = text(metadata, "data_format", "hdf5");
    if (format != "hdf5") {
      throw std::runtime_error(path.string() + ": data_format is '" + format +
                               "'; only hdf5 can be read");
    }
    if (const auto spec = metadata.find("env_spec"); spec != metadata.end() && spec->is_string()) {
      const json environment = json::parse(spec->get<std::string>(), nullptr, false);
      if (environment.is_object()) environment_ = text(environment, "id", "");
    }
    if (environment_.empty()) environment_ = text(metadata, "dataset_id", "");
  }

  Hdf5File file_;
  std::vector<std::string> episodes_;
  core::StateLayout layout_;
  core::StateLayout controls_;
  std::string environment_;
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
    const std::string episode = kPrefix + std::to_string(episodes_);
    const bool completed = trajectory.outcome == Outcome::kCompleted;
    std::vector<double> rewards(steps, 0.0);
    std::vector<bool> terminations(steps, false);
    std::vector<bool> truncations(steps, false);
    rewards.back() = completed ? 1.0 : 0.0;
    terminations.back() = completed;
    truncations.back() = !completed;

    file_.CreateGroup(episode);
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
    file_.SetAttribute(episode, "total_steps", static_cast<std::int64_t>(steps));
    file_.SetAttribute(episode, "seed", static_cast<std::int64_t>(trajectory.seed));
    file_.SetAttribute(episode, "outcome", std::string(core::Name(trajectory.outcome)));
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

  // Replaced as a whole, so that a reader never sees half of it.
  void WriteMetadata() const {
    const json metadata = {{"total_episodes", episodes_},
                           {"total_steps", total_},
                           {"data_format", "hdf5"},
                           {"jpeg_encoding", false},
                           {"dataset_id", dataset_id_},
                           {"minari_version", kMinariVersion},
                           {"env_spec", json({{"id", environment_}}).dump()},
                           {"observation_space", ObservationText(layout_)},
                           {"action_space", BoxText(control_dim_, "-1.0", "1.0")}};
    const std::filesystem::path path = folder_ / "metadata.json";
    std::filesystem::path part = path;
    part += ".part";
    {
      std::ofstream out(part);
      out << metadata.dump(2, ' ', false, json::error_handler_t::replace) << '\n';
      out.close();
      if (!out) throw std::runtime_error(part.string() + ": cannot be written");
    }
    std::filesystem::rename(part, path);
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
  DFR_THROW_UNLESS(!dataset_id.empty(), "a Minari dataset needs an id, <namespace>/<name>-v<n>");
  file_ = std::make_unique<File>(folder, dataset_id, std::move(layout), control_dim, environment);
}

MinariWriter::MinariWriter(MinariWriter&&) noexcept = default;
MinariWriter& MinariWriter::operator=(MinariWriter&&) noexcept = default;
MinariWriter::~MinariWriter() = default;

void MinariWriter::Append(const core::Trajectory& trajectory) { file_->Append(trajectory); }

int MinariWriter::num_episodes() const noexcept { return file_->num_episodes(); }

void SaveMinari(const DemonstrationSet& demonstrations, const std::filesystem::path& folder,
                const std::string& dataset_id) {
  for (std::size_t i = 0; i < demonstrations.trajectories.size(); ++i) {
    // All are checked before the first is written, and an existing file replaced.
    internal::CheckTrajectory(demonstrations.trajectories[i], demonstrations.layout.state_dim(),
                              demonstrations.control_dim, static_cast<int>(i));
  }
  MinariWriter writer(folder, dataset_id, demonstrations.layout, demonstrations.control_dim,
                      demonstrations.environment);
  for (const auto& trajectory : demonstrations.trajectories) writer.Append(trajectory);
}

std::unique_ptr<DemonstrationReader> OpenMinari(const std::filesystem::path& path) {
  return std::make_unique<MinariReader>(MainFile(path));
}

}  // namespace dfr::imitation
