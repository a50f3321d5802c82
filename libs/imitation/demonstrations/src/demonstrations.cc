#include "dfr/imitation/demonstrations.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "dfr/imitation/lerobot.h"
#include "dfr/imitation/minari.h"
#include "episode_io.h"
#include "hdf5/hdf5_file.h"

namespace dfr::imitation {
namespace {

using core::Matrix;
using internal::Hdf5File;
using internal::Hdf5Reader;

constexpr std::string_view kEpisodePrefix = "demo_";
constexpr char kCount[] = "num_samples";
constexpr int kGymEnvironment = 2;  // robomimic's EnvType.GYM_TYPE

std::string EnvironmentName(const Hdf5Reader& file) {
  const std::optional<std::string> text = file.TextAttribute("data", "env_args");
  if (!text) return "";
  const auto json = nlohmann::json::parse(*text, nullptr, /*allow_exceptions=*/false);
  if (!json.is_object()) file.Fail("data", "attribute env_args is not a JSON object");
  const auto name = json.find("env_name");
  return name != json.end() && name->is_string() ? name->get<std::string>() : "";
}

class RobomimicReader final : public internal::EpisodeReader {
 public:
  RobomimicReader(Hdf5Reader opened, const std::string& filter_key,
                  std::vector<std::string> pictures)
      : EpisodeReader(std::move(opened), std::move(pictures)) {
    if (!file().Exists("data")) file().Fail("data", "does not exist: this is not a robomimic file");
    environment_ = EnvironmentName(file());
    discarded_ = static_cast<int>(file().IntegerAttribute("data", "discarded").value_or(0));
    try {
      provenance_ =
          core::ParseProvenance(file().TextAttribute("data", "provenance").value_or(std::string()));
    } catch (const std::invalid_argument& e) {
      file().Fail("data", e.what());
    }
    FindEpisodes("data", kEpisodePrefix, "obs", kCount);
    if (!filter_key.empty()) KeepMasked(filter_key);
  }

  [[nodiscard]] int discarded() const noexcept override { return discarded_; }
  [[nodiscard]] const core::Provenance& provenance() const noexcept override { return provenance_; }

 private:
  [[nodiscard]] core::Trajectory ReadEpisode(const std::string& episode) const override {
    const std::optional<std::int64_t> samples = file().IntegerAttribute(episode, kCount);
    if (!samples) file().Fail(episode, "has no attribute num_samples");
    if (*samples < 1)
      file().Fail(episode, "num_samples is " + std::to_string(*samples) + ", not positive");
    const Eigen::Index n = *samples;

    core::Trajectory trajectory;
    trajectory.controls = ReadActions(episode, n, kCount);
    trajectory.states = ReadStates(episode, n, kCount);
    if (file().Exists(episode + "/next_obs")) {
      const Matrix next = internal::ReadBlocks(file(), episode + "/next_obs", layout(), n, kCount);
      trajectory.states.conservativeResize(n + 1, Eigen::NoChange);
      trajectory.states.row(n) = next.row(n - 1);
    } else {
      if (n == 1)
        file().Fail(episode, "has one step and no next_obs: no state follows its control");
      trajectory.controls.conservativeResize(n - 1, Eigen::NoChange);
    }
    if (const auto outcome = Outcome(episode)) {
      trajectory.outcome = *outcome;
    } else if (const auto success = file().IntegerAttribute(episode, "success")) {  // Isaac Lab
      trajectory.outcome = *success != 0 ? core::Outcome::kCompleted : core::Outcome::kHalted;
    } else if (file().Exists(episode + "/dones")) {
      const Matrix dones = internal::ReadRows(file(), episode + "/dones", n, kCount);
      const bool completed = dones(n - 1, 0) != 0.0;
      trajectory.outcome = completed ? core::Outcome::kCompleted : core::Outcome::kHalted;
    }
    return trajectory;
  }

  int discarded_ = 0;
  core::Provenance provenance_;
};

DemonstrationSet ReadAll(const DemonstrationReader& reader) {
  DemonstrationSet demonstrations;
  demonstrations.layout = reader.layout();
  demonstrations.control_dim = reader.control_dim();
  demonstrations.environment = reader.environment();
  demonstrations.discarded = reader.discarded();
  demonstrations.note = reader.note();
  demonstrations.provenance = reader.provenance();
  demonstrations.trajectories.reserve(static_cast<std::size_t>(reader.num_episodes()));
  for (int i = 0; i < reader.num_episodes(); ++i) {
    demonstrations.trajectories.push_back(reader.Read(i));
  }
  return demonstrations;
}

}  // namespace

const std::string& DemonstrationReader::note() const noexcept {
  static const std::string empty;
  return empty;
}

const core::Provenance& DemonstrationReader::provenance() const noexcept {
  static const core::Provenance unknown;
  return unknown;
}

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
    file_.CreateSecondList();
    file_.SetAttribute("data", "env_args",
                       env_args.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
    file_.SetAttribute("data", "total", 0);
    file_.SetAttribute("data", "discarded", 0);
    file_.Flush();
  }

  void Append(const core::Trajectory& trajectory) {
    internal::CheckTrajectory(trajectory, layout_.state_dim(), control_dim_, episodes_);
    const Eigen::Index n = trajectory.controls.rows();
    const std::string episode = Hdf5File::kNewGroup;
    const bool completed = trajectory.outcome == core::Outcome::kCompleted;
    std::vector<double> rewards(static_cast<std::size_t>(n), 0.0);
    std::vector<std::int64_t> dones(static_cast<std::size_t>(n), 0);
    rewards.back() = completed ? 1.0 : 0.0;
    dones.back() = completed ? 1 : 0;

    file_.CreateNewGroup();
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
    file_.SetAttribute(episode, kCount, n);
    Finish(std::string(kEpisodePrefix) + std::to_string(episodes_));
    total_ += n;
    ++episodes_;
    file_.SetAttribute("data", "total", total_);
    file_.SetAttribute(Hdf5File::kSecondList, Hdf5File::kListed, episodes_);
    file_.Flush();
  }

  void SetProvenance(const core::Provenance& provenance) {
    file_.SetAttribute("data", "provenance", core::ToText(provenance));
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
  // libhdf5 changes a list in several writes. A kill between them leaves an unreadable list.
  // Therefore the episode's data reach the disk first, then its name in one list, then its name in
  // the other, then the counts. One of the lists is intact at any time.
  void Finish(const std::string& name) {
    file_.Flush();
    file_.LinkNewGroup(std::string(Hdf5File::kSecondList) + "/" + name);
    file_.Flush();
    file_.LinkNewGroup("data/" + name);
    file_.Flush();
  }

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

void RobomimicWriter::SetProvenance(const core::Provenance& provenance) {
  file_->SetProvenance(provenance);
}

void RobomimicWriter::CopyOrigin(const DemonstrationReader& from) {
  if (from.provenance() != core::Provenance()) SetProvenance(from.provenance());
  if (from.discarded() > 0) file_->SetDiscarded(from.discarded());
}

void RobomimicWriter::CountDiscarded(int episodes) {
  file_->SetDiscarded(file_->discarded() + episodes);
}

int RobomimicWriter::num_episodes() const noexcept { return file_->num_episodes(); }

void SaveRobomimic(const DemonstrationSet& demonstrations, const std::filesystem::path& path,
                   const std::string& model_xml) {
  RobomimicWriter writer = internal::WriteAll(demonstrations, [&] {
    RobomimicWriter made(path, demonstrations.layout, demonstrations.control_dim,
                         demonstrations.environment, model_xml);
    if (demonstrations.provenance != core::Provenance()) {
      made.SetProvenance(demonstrations.provenance);
    }
    return made;
  });
  if (demonstrations.discarded > 0) writer.CountDiscarded(demonstrations.discarded);
}

std::unique_ptr<DemonstrationReader> OpenRobomimic(const std::filesystem::path& path,
                                                   const std::string& filter_key,
                                                   const std::vector<std::string>& pictures) {
  return std::make_unique<RobomimicReader>(Hdf5Reader(path), filter_key, pictures);
}

std::unique_ptr<DemonstrationReader> OpenDemonstrations(
    const std::filesystem::path& path, const std::string& filter_key,
    const std::vector<core::BlockRequest>& pictures) {
  if (IsLeRobot(path)) return OpenLeRobot(path, filter_key, pictures);
  std::vector<std::string> names;
  names.reserve(pictures.size());
  for (const core::BlockRequest& picture : pictures) names.push_back(picture.name);
  if (!std::filesystem::is_directory(path)) {
    Hdf5Reader file(path);
    if (file.Exists("data")) {
      return std::make_unique<RobomimicReader>(std::move(file), filter_key, std::move(names));
    }
    if (file.Exists("action") && file.Exists("observations")) {
      file.Fail(
          "observations",
          "this is one episode in ALOHA's layout. Convert its folder to a LeRobot dataset with "
          "LeRobot's scripts, or copy observations/qpos and action of each episode to "
          "data/demo_<i>/obs/qpos and data/demo_<i>/actions of one file");
    }
  }
  if (!filter_key.empty()) {
    throw std::runtime_error(
        path.string() + ": has no filter keys, so '" + filter_key +
        "' names no episodes; robomimic's files and LeRobot's datasets have them");
  }
  return OpenMinari(path, names);
}

std::vector<core::BlockRequest> PictureRequests(const core::StateLayout& layout) {
  std::vector<core::BlockRequest> requests;
  for (const auto& block : layout.blocks) {
    const auto& [height, width, channels] = block.picture;
    if (height > 0) requests.push_back({block.name, height, width});
  }
  return requests;
}

DemonstrationSet LoadDemonstrations(const std::filesystem::path& path) {
  return ReadAll(*OpenDemonstrations(path));
}

DemonstrationSet LoadRobomimic(const std::filesystem::path& path) {
  return ReadAll(*OpenRobomimic(path));
}

}  // namespace dfr::imitation
