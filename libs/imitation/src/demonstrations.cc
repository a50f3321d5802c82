#include "dfr/imitation/demonstrations.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "dfr/core/contract.h"
#include "hdf5_file.h"

namespace dfr::imitation {
namespace {

using core::Matrix;
using core::Outcome;
using internal::Hdf5File;

constexpr std::string_view kEpisodePrefix = "demo_";
constexpr int kGymEnvironment = 2;  // robomimic's EnvType.GYM_TYPE

void CheckTrajectory(const core::Trajectory& trajectory, int state_dim, int control_dim,
                     int episode) {
  const Eigen::Index steps = trajectory.controls.rows();
  DFR_THROW_UNLESS(steps > 0, "demonstration " << episode << " has no control");
  DFR_THROW_UNLESS(trajectory.controls.cols() == control_dim &&
                       trajectory.states.cols() == state_dim &&
                       trajectory.states.rows() == steps + 1,
                   "demonstration " << episode << " has states of " << trajectory.states.rows()
                                    << " x " << trajectory.states.cols() << " and controls of "
                                    << steps << " x " << trajectory.controls.cols() << "; " << steps
                                    << " controls need " << steps + 1 << " x " << state_dim
                                    << " and " << steps << " x " << control_dim);
  for (Eigen::Index t = 0; t < steps; ++t) {
    for (Eigen::Index j = 0; j < control_dim; ++j) {
      const double u = trajectory.controls(t, j);
      DFR_THROW_UNLESS(std::abs(u) <= 1.0, "demonstration "
                                               << episode << ", step " << t << ": control " << j
                                               << " is " << u
                                               << "; robomimic files hold controls scaled to "
                                                  "[-1, 1]");
    }
  }
  for (Eigen::Index t = 0; t <= steps; ++t) {
    for (Eigen::Index j = 0; j < state_dim; ++j) {
      DFR_THROW_UNLESS(std::isfinite(trajectory.states(t, j)),
                       "demonstration " << episode << ", step " << t << ": state entry " << j
                                        << " is " << trajectory.states(t, j));
    }
  }
}

std::optional<Outcome> ParseOutcome(std::string_view name) {
  for (const Outcome outcome : {Outcome::kCompleted, Outcome::kHalted, Outcome::kCollided}) {
    if (name == core::Name(outcome)) return outcome;
  }
  return std::nullopt;
}

// Paths of the episodes in the order of their numbers.
std::vector<std::string> Episodes(const Hdf5File& file) {
  std::vector<std::pair<std::int64_t, std::string>> numbered;
  for (const std::string& name : file.Members("data")) {
    std::int64_t number = 0;
    const char* const begin = name.data() + std::min(kEpisodePrefix.size(), name.size());
    const char* const end = name.data() + name.size();
    const auto [stop, error] = std::from_chars(begin, end, number);
    if (!name.starts_with(kEpisodePrefix) || error != std::errc() || stop != end) {
      file.Fail("data/" + name, "is not named demo_<number>");
    }
    numbered.emplace_back(number, "data/" + name);
  }
  std::sort(numbered.begin(), numbered.end());
  std::vector<std::string> paths;
  paths.reserve(numbered.size());
  for (auto& [number, path] : numbered) paths.push_back(std::move(path));
  return paths;
}

void CheckFinite(const Hdf5File& file, const std::string& path, const Matrix& values) {
  for (Eigen::Index i = 0; i < values.rows(); ++i) {
    for (Eigen::Index j = 0; j < values.cols(); ++j) {
      if (!std::isfinite(values(i, j))) {
        file.Fail(path, "row " + std::to_string(i) + ", column " + std::to_string(j) + " is " +
                            std::to_string(values(i, j)));
      }
    }
  }
}

Matrix ReadRows(const Hdf5File& file, const std::string& path, Eigen::Index rows) {
  if (!file.Exists(path)) file.Fail(path, "does not exist");
  Matrix values = file.Read(path);
  if (values.rows() != rows) {
    file.Fail(path, "has " + std::to_string(values.rows()) + " rows; num_samples is " +
                        std::to_string(rows));
  }
  CheckFinite(file, path, values);
  return values;
}

// The vector-valued observations of an episode, in the order of the state.
core::StateLayout ReadLayout(const Hdf5File& file, const std::string& episode) {
  const std::string group = episode + "/obs";
  if (!file.Exists(group)) file.Fail(group, "does not exist");
  struct Key {
    std::int64_t offset;
    std::string name;
    int size;
  };
  std::vector<Key> keys;
  bool all_have_offsets = true;
  for (const std::string& name : file.Members(group)) {
    std::string path = group;
    path += "/" + name;
    const std::vector<std::int64_t> shape = file.Shape(path);
    if (shape.empty()) file.Fail(path, "is a single value, not one row per step");
    if (shape.size() > 2) continue;
    const std::int64_t size = shape.size() == 2 ? shape[1] : 1;
    constexpr std::int64_t kMost = 1 << 20;
    if (size < 1 || size > kMost) file.Fail(path, "has " + std::to_string(size) + " columns");
    const std::optional<std::int64_t> offset = file.IntegerAttribute(path, "offset");
    all_have_offsets = all_have_offsets && offset.has_value();
    keys.push_back({offset.value_or(0), name, static_cast<int>(size)});
  }
  if (keys.empty()) file.Fail(group, "has no vector-valued dataset");
  if (all_have_offsets) {
    std::stable_sort(keys.begin(), keys.end(),
                     [](const Key& a, const Key& b) { return a.offset < b.offset; });
  }
  core::StateLayout layout;
  for (const Key& key : keys) layout.Add(key.name, key.size);
  return layout;
}

Matrix ReadStates(const Hdf5File& file, const std::string& group, const core::StateLayout& layout,
                  Eigen::Index rows) {
  Matrix states(rows, layout.state_dim());
  for (const auto& block : layout.blocks) {
    const std::string path = group + "/" + block.name;
    const Matrix values = ReadRows(file, path, rows);
    if (values.cols() != block.size) {
      file.Fail(path, "has " + std::to_string(values.cols()) + " columns, not " +
                          std::to_string(block.size));
    }
    states.middleCols(block.offset, block.size) = values;
  }
  return states;
}

core::Trajectory ReadEpisode(const Hdf5File& file, const std::string& episode,
                             const core::StateLayout& layout) {
  const std::optional<std::int64_t> samples = file.IntegerAttribute(episode, "num_samples");
  if (!samples) file.Fail(episode, "has no attribute num_samples");
  if (*samples < 1) file.Fail(episode, "num_samples is " + std::to_string(*samples));
  const Eigen::Index n = *samples;

  core::Trajectory trajectory;
  trajectory.controls = ReadRows(file, episode + "/actions", n);
  trajectory.states = ReadStates(file, episode + "/obs", layout, n);
  if (file.Exists(episode + "/next_obs")) {
    const Matrix next = ReadStates(file, episode + "/next_obs", layout, n);
    trajectory.states.conservativeResize(n + 1, Eigen::NoChange);
    trajectory.states.row(n) = next.row(n - 1);
  } else {
    if (n == 1) file.Fail(episode, "has one step and no next_obs: no state after a control");
    trajectory.controls.conservativeResize(n - 1, Eigen::NoChange);
  }

  trajectory.seed = static_cast<std::uint64_t>(file.IntegerAttribute(episode, "seed").value_or(0));
  if (const std::optional<std::string> name = file.TextAttribute(episode, "outcome")) {
    const std::optional<Outcome> outcome = ParseOutcome(*name);
    if (!outcome) file.Fail(episode, "outcome '" + *name + "' is unknown");
    trajectory.outcome = *outcome;
  } else if (file.Exists(episode + "/dones")) {
    const Matrix dones = ReadRows(file, episode + "/dones", n);
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
    CheckTrajectory(trajectory, layout_.state_dim(), control_dim_, episodes_);
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
  DFR_THROW_UNLESS(layout.state_dim() > 0, "demonstrations need a state layout");
  DFR_THROW_UNLESS(control_dim > 0, "demonstrations need controls, not " << control_dim);
  for (const auto& block : layout.blocks) {
    DFR_THROW_UNLESS(!block.name.empty() && block.name.find('/') == std::string::npos,
                     "state block '" << block.name << "' cannot name a dataset");
  }
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
    CheckTrajectory(demonstrations.trajectories[i], state_dim, demonstrations.control_dim,
                    static_cast<int>(i));
  }
  RobomimicWriter writer(path, demonstrations.layout, demonstrations.control_dim,
                         demonstrations.environment, model_xml);
  for (const auto& trajectory : demonstrations.trajectories) writer.Append(trajectory);
  for (int i = 0; i < demonstrations.discarded; ++i) writer.CountDiscarded();
}

DemonstrationSet LoadRobomimic(const std::filesystem::path& path) {
  const Hdf5File file = Hdf5File::Open(path);
  if (!file.Exists("data")) file.Fail("data", "does not exist: this is no robomimic file");
  DemonstrationSet demonstrations;
  demonstrations.environment = EnvironmentName(file);
  demonstrations.discarded =
      static_cast<int>(file.IntegerAttribute("data", "discarded").value_or(0));
  for (const std::string& episode : Episodes(file)) {
    core::StateLayout layout = ReadLayout(file, episode);
    if (demonstrations.trajectories.empty()) {
      demonstrations.layout = std::move(layout);
    } else if (layout != demonstrations.layout) {
      file.Fail(episode + "/obs", "has other datasets or sizes than the first episode's");
    }
    core::Trajectory trajectory = ReadEpisode(file, episode, demonstrations.layout);
    const int control_dim = static_cast<int>(trajectory.controls.cols());
    if (demonstrations.trajectories.empty()) {
      demonstrations.control_dim = control_dim;
    } else if (control_dim != demonstrations.control_dim) {
      file.Fail(episode + "/actions", "has " + std::to_string(control_dim) +
                                          " columns, the first episode's has " +
                                          std::to_string(demonstrations.control_dim));
    }
    demonstrations.trajectories.push_back(std::move(trajectory));
  }
  if (demonstrations.trajectories.empty()) file.Fail("data", "holds no episode");
  return demonstrations;
}

}  // namespace dfr::imitation
