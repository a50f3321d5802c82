#include "dfr/imitation/demonstrations.h"

#include <nlohmann/json.hpp>
#include <optional>
#include <string_view>
#include <utility>

#include "dfr/imitation/minari.h"
#include "episode_io.h"
#include "hdf5_file.h"

namespace dfr::imitation {
namespace {

using core::Matrix;
using core::Outcome;
using internal::Hdf5File;

constexpr std::string_view kEpisodePrefix = "demo_";
constexpr int kGymEnvironment = 2;  // robomimic's EnvType.GYM_TYPE

core::Trajectory ReadEpisode(const Hdf5File& file, const std::string& episode,
                             const core::StateLayout& layout) {
  const std::optional<std::int64_t> samples = file.IntegerAttribute(episode, "num_samples");
  if (!samples) file.Fail(episode, "has no attribute num_samples");
  if (*samples < 1) file.Fail(episode, "num_samples is " + std::to_string(*samples));
  const Eigen::Index n = *samples;
  constexpr char kCount[] = "num_samples";

  core::Trajectory trajectory;
  trajectory.controls = internal::ReadRows(file, episode + "/actions", n, kCount);
  trajectory.states = internal::ReadBlocks(file, episode + "/obs", layout, n, kCount);
  if (file.Exists(episode + "/next_obs")) {
    const Matrix next = internal::ReadBlocks(file, episode + "/next_obs", layout, n, kCount);
    trajectory.states.conservativeResize(n + 1, Eigen::NoChange);
    trajectory.states.row(n) = next.row(n - 1);
  } else {
    if (n == 1) file.Fail(episode, "has one step and no next_obs: no state after a control");
    trajectory.controls.conservativeResize(n - 1, Eigen::NoChange);
  }

  trajectory.seed = static_cast<std::uint64_t>(file.IntegerAttribute(episode, "seed").value_or(0));
  if (const std::optional<std::string> name = file.TextAttribute(episode, "outcome")) {
    const std::optional<Outcome> outcome = internal::ParseOutcome(*name);
    if (!outcome) file.Fail(episode, "outcome '" + *name + "' is unknown");
    trajectory.outcome = *outcome;
  } else if (file.Exists(episode + "/dones")) {
    const Matrix dones = internal::ReadRows(file, episode + "/dones", n, kCount);
    trajectory.outcome = dones(n - 1, 0) != 0.0 ? Outcome::kCompleted : Outcome::kHalted;
  }
  return trajectory;
}

std::string EnvironmentName(const Hdf5File& file) {
  const std::optional<std::string> text = file.TextAttribute("data", "env_args");
  if (!text) return "";
  const auto json = nlohmann::json::parse(*text, nullptr, /*allow_exceptions=*/false);
  if (!json.is_object()) file.Fail("data", "attribute env_args is not a JSON object");
  const auto name = json.find("env_name");
  return name != json.end() && name->is_string() ? name->get<std::string>() : "";
}

class RobomimicReader final : public DemonstrationReader {
 public:
  explicit RobomimicReader(const std::filesystem::path& path) : file_(Hdf5File::Open(path)) {
    if (!file_.Exists("data")) file_.Fail("data", "does not exist: this is no robomimic file");
    environment_ = EnvironmentName(file_);
    discarded_ = static_cast<int>(file_.IntegerAttribute("data", "discarded").value_or(0));
    episodes_ = internal::NumberedMembers(file_, "data", kEpisodePrefix);
    if (episodes_.empty()) file_.Fail("data", "holds no episode");
    layout_ = internal::ReadLayout(file_, episodes_[0] + "/obs");
    const std::string actions = episodes_[0] + "/actions";
    if (!file_.Exists(actions)) file_.Fail(actions, "does not exist");
    const std::vector<std::int64_t> shape = file_.Shape(actions);
    control_dim_ = shape.size() == 2 ? static_cast<int>(shape[1]) : 1;
  }

  [[nodiscard]] const core::StateLayout& layout() const noexcept override { return layout_; }
  [[nodiscard]] int control_dim() const noexcept override { return control_dim_; }
  [[nodiscard]] const std::string& environment() const noexcept override { return environment_; }
  [[nodiscard]] int discarded() const noexcept override { return discarded_; }
  [[nodiscard]] int num_episodes() const noexcept override {
    return static_cast<int>(episodes_.size());
  }
  [[nodiscard]] const std::string& name(int i) const override {
    return episodes_.at(static_cast<std::size_t>(i));
  }

  [[nodiscard]] core::Trajectory Read(int i) const override {
    const std::string& episode = name(i);
    if (internal::ReadLayout(file_, episode + "/obs") != layout_) {
      file_.Fail(episode + "/obs", "has other datasets or sizes than the first episode's");
    }
    core::Trajectory trajectory = ReadEpisode(file_, episode, layout_);
    if (trajectory.controls.cols() != control_dim_) {
      file_.Fail(episode + "/actions", "has " + std::to_string(trajectory.controls.cols()) +
                                           " columns, the first episode's has " +
                                           std::to_string(control_dim_));
    }
    return trajectory;
  }

 private:
  Hdf5File file_;
  std::vector<std::string> episodes_;
  core::StateLayout layout_;
  int control_dim_ = 0;
  int discarded_ = 0;
  std::string environment_;
};

DemonstrationSet ReadAll(const DemonstrationReader& reader) {
  DemonstrationSet demonstrations;
  demonstrations.layout = reader.layout();
  demonstrations.control_dim = reader.control_dim();
  demonstrations.environment = reader.environment();
  demonstrations.discarded = reader.discarded();
  demonstrations.trajectories.reserve(static_cast<std::size_t>(reader.num_episodes()));
  for (int i = 0; i < reader.num_episodes(); ++i) {
    demonstrations.trajectories.push_back(reader.Read(i));
  }
  return demonstrations;
}

}  // namespace

class RobomimicWriter::File {
 public:
  File(const std::filesystem::path& path, core::StateLayout layout, int control_dim,
       const std::string& environment, std::string model_xml)
      : file_(Hdf5File::Create(path)),
        layout_(std::move(layout)),
        control_dim_(control_dim),
        model_xml_(std::move(model_xml)) {
    const nlohmann::json env_args = {{"env_name", environment},
                                     {"env_type", kGymEnvironment},
                                     {"type", kGymEnvironment},
                                     {"env_kwargs", nlohmann::json::object()}};
    file_.CreateGroup("data");
    file_.SetAttribute("data", "env_args",
                       env_args.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
    file_.SetAttribute("data", "total", 0);
    file_.SetAttribute("data", "discarded", 0);
    file_.Flush();
  }

  void Append(const core::Trajectory& trajectory) {
    internal::CheckTrajectory(trajectory, layout_.state_dim(), control_dim_, episodes_);
    const Eigen::Index n = trajectory.controls.rows();
    const std::string episode = "data/" + std::string(kEpisodePrefix) + std::to_string(episodes_);
    const bool completed = trajectory.outcome == Outcome::kCompleted;
    std::vector<double> rewards(static_cast<std::size_t>(n), 0.0);
    std::vector<std::int64_t> dones(static_cast<std::size_t>(n), 0);
    rewards.back() = completed ? 1.0 : 0.0;
    dones.back() = completed ? 1 : 0;

    file_.CreateGroup(episode);
    file_.Write(episode + "/actions", trajectory.controls);
    file_.Write(episode + "/states", Matrix(trajectory.states.topRows(n)));
    file_.Write(episode + "/rewards", rewards);
    file_.Write(episode + "/dones", dones);
    for (const bool next : {false, true}) {
      const std::string group = episode + (next ? "/next_obs" : "/obs");
      file_.CreateGroup(group);
      for (const auto& block : layout_.blocks) {
        const std::string path = group + "/" + block.name;
        file_.Write(path,
                    Matrix(trajectory.states.block(next ? 1 : 0, block.offset, n, block.size)));
        file_.SetAttribute(path, "offset", block.offset);
      }
    }
    file_.SetAttribute(episode, "model_file", model_xml_);
    file_.SetAttribute(episode, "seed", static_cast<std::int64_t>(trajectory.seed));
    file_.SetAttribute(episode, "outcome", std::string(core::Name(trajectory.outcome)));
    file_.SetAttribute(episode, "num_samples", n);
    total_ += n;
    ++episodes_;
    file_.SetAttribute("data", "total", total_);
    file_.Flush();
  }

  void SetDiscarded(int discarded) {
    discarded_ = discarded;
    file_.SetAttribute("data", "discarded", discarded_);
    file_.Flush();
  }
  [[nodiscard]] int discarded() const noexcept { return discarded_; }
  [[nodiscard]] int num_episodes() const noexcept { return episodes_; }

 private:
  Hdf5File file_;
  core::StateLayout layout_;
  int control_dim_;
  std::string model_xml_;
  int episodes_ = 0;
  int discarded_ = 0;
  std::int64_t total_ = 0;
};

RobomimicWriter::RobomimicWriter(const std::filesystem::path& path, core::StateLayout layout,
                                 int control_dim, const std::string& environment,
                                 std::string model_xml) {
  internal::CheckLayout(layout, control_dim);
  file_ = std::make_unique<File>(path, std::move(layout), control_dim, environment,
                                 std::move(model_xml));
}

RobomimicWriter::RobomimicWriter(RobomimicWriter&&) noexcept = default;
RobomimicWriter& RobomimicWriter::operator=(RobomimicWriter&&) noexcept = default;
RobomimicWriter::~RobomimicWriter() = default;

void RobomimicWriter::Append(const core::Trajectory& trajectory) { file_->Append(trajectory); }

void RobomimicWriter::CountDiscarded() { file_->SetDiscarded(file_->discarded() + 1); }

int RobomimicWriter::num_episodes() const noexcept { return file_->num_episodes(); }

void SaveRobomimic(const DemonstrationSet& demonstrations, const std::filesystem::path& path,
                   const std::string& model_xml) {
  const int state_dim = demonstrations.layout.state_dim();
  for (std::size_t i = 0; i < demonstrations.trajectories.size(); ++i) {
    // All are checked before the first is written, and an existing file replaced.
    internal::CheckTrajectory(demonstrations.trajectories[i], state_dim, demonstrations.control_dim,
                              static_cast<int>(i));
  }
  RobomimicWriter writer(path, demonstrations.layout, demonstrations.control_dim,
                         demonstrations.environment, model_xml);
  for (const auto& trajectory : demonstrations.trajectories) writer.Append(trajectory);
  for (int i = 0; i < demonstrations.discarded; ++i) writer.CountDiscarded();
}

std::unique_ptr<DemonstrationReader> OpenRobomimic(const std::filesystem::path& path) {
  return std::make_unique<RobomimicReader>(path);
}

std::unique_ptr<DemonstrationReader> OpenDemonstrations(const std::filesystem::path& path) {
  if (std::filesystem::is_directory(path)) return OpenMinari(path);
  // Closed again before the reader opens it.
  const bool robomimic = Hdf5File::Open(path).Exists("data");
  return robomimic ? OpenRobomimic(path) : OpenMinari(path);
}

DemonstrationSet LoadDemonstrations(const std::filesystem::path& path) {
  return ReadAll(*OpenDemonstrations(path));
}

DemonstrationSet LoadRobomimic(const std::filesystem::path& path) {
  return ReadAll(*OpenRobomimic(path));
}

}  // namespace dfr::imitation
