#include "episode_io.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <set>
#include <stdexcept>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/text/format.h"
#include "dfr/core/text/numbers.h"

namespace dfr::imitation::internal {
namespace {

using core::Matrix;

struct Key {
  std::int64_t offset;
  std::string name;
  int size;
  core::PictureShape picture = {};
};

using Pictures = std::vector<std::string>;

constexpr char kActions[] = "actions";

// Maximum nesting of groups of observations. No format has more; deeper nesting indicates a
// circular link.
constexpr int kDeepest = 8;

// Maximum number of groups and datasets of a part of an episode. With links, the number of paths in
// a small file can grow exponentially with the depth.
constexpr int kMostObjects = 1 << 10;

// Throws RequestError naming the file, `path` and `reason`.
[[noreturn]] void RefuseRequest(const Hdf5Reader& file, const std::string& path,
                                const std::string& reason) {
  throw RequestError(file.name() + ": " + path + ": " + reason);
}

// Returns the key of a dataset (N, height, width) or (N, height, width, channels). The key's offset
// places pictures after all other datasets.
Key PictureKey(const Hdf5Reader& file, const std::string& path, const std::string& name,
               const std::vector<std::int64_t>& shape) {
  constexpr std::int64_t kMost = 1 << 13;
  if (shape.size() > 4) {
    RefuseRequest(file, path,
                  "holds no pictures: a dataset of pictures has 3 or 4 dimensions, (steps, height, "
                  "width, channels), not " +
                      std::to_string(shape.size()));
  }
  if (!file.IsNumeric(path)) RefuseRequest(file, path, "is not numeric");
  const std::int64_t channels = shape.size() == 4 ? shape[3] : 1;
  if (shape[1] < 1 || shape[1] > kMost || shape[2] < 1 || shape[2] > kMost ||
      (channels != 1 && channels != 3)) {
    RefuseRequest(file, path,
                  "holds pictures of " + std::to_string(shape[1]) + " x " +
                      std::to_string(shape[2]) + " x " + std::to_string(channels) +
                      "; height and width must lie in [1, " + std::to_string(kMost) +
                      "], and channels, the last dimension, must be 1 or 3");
  }
  const core::PictureShape picture{static_cast<int>(shape[1]), static_cast<int>(shape[2]),
                                   static_cast<int>(channels)};
  return {std::numeric_limits<std::int64_t>::max(), name,
          picture.height * picture.width * picture.channels, picture};
}

// Appends the keys of the dataset at `path`, or of all datasets in the group at `path`. Returns
// false if a dataset has no offset.
bool CollectKeys(const Hdf5Reader& file, const std::string& path, const std::string& name,
                 int depth, const Pictures& pictures, int& objects, std::vector<Key>& keys) {
  if (++objects > kMostObjects) {
    file.Fail(path, "is one of more than " + std::to_string(kMostObjects) +
                        " groups and datasets of this part of an episode; remove some");
  }
  if (file.IsGroup(path)) {
    if (depth > kDeepest) {
      file.Fail(path, "is nested more than " + std::to_string(kDeepest) + " groups deep");
    }
    bool all_have_offsets = true;
    for (const std::string& member : file.Members(path)) {
      std::string below = depth == 0 ? "" : name + "/";
      below += member;
      std::string inner = path + "/";
      inner += member;
      all_have_offsets &= CollectKeys(file, inner, below, depth + 1, pictures, objects, keys);
    }
    return all_have_offsets;
  }
  const std::vector<std::int64_t> shape = file.Shape(path);
  if (shape.empty()) file.Fail(path, "is a single value, not one row per step");
  if (shape.size() > 2 && std::ranges::count(pictures, name) > 0) {
    keys.push_back(PictureKey(file, path, name, shape));
    return true;
  }
  if (shape.size() > 2) return true;
  if (!file.IsNumeric(path)) file.Fail(path, "is not numeric");
  const std::int64_t size = shape.size() == 2 ? shape[1] : 1;
  constexpr std::int64_t kMost = 1 << 20;
  if (size < 1 || size > kMost)
    file.Fail(path, "has " + std::to_string(size) + " columns; 1 to " + std::to_string(kMost) +
                        " are supported");
  if (!core::IsUtf8(name)) file.Fail(path, "has a name that is not UTF-8; rename it");
  const std::optional<std::int64_t> offset = file.IntegerAttribute(path, "offset");
  keys.push_back({offset.value_or(0), name, static_cast<int>(size)});
  return offset.has_value();
}

// Returns the members of `group` named <prefix><number>, as paths in the order of the numbers.
std::vector<std::string> NumberedMembers(const Hdf5Reader& file, const std::string& group,
                                         std::string_view prefix) {
  const std::string folder = group.empty() ? "" : group + "/";
  std::vector<std::pair<std::int64_t, std::string>> numbered;
  for (const std::string& name : file.Members(group)) {
    if (name == Hdf5File::kSecondList) continue;
    const std::string_view digits =
        std::string_view(name).substr(std::min(prefix.size(), name.size()));
    const std::optional<std::int64_t> number = core::ParseInteger<std::int64_t>(digits);
    if (!name.starts_with(prefix) || !number) {
      file.Fail(folder + name, "is not named " + std::string(prefix) + "<number>");
    }
    numbered.emplace_back(*number, folder + name);
  }
  std::sort(numbered.begin(), numbered.end());
  std::vector<std::string> paths;
  paths.reserve(numbered.size());
  for (auto& [number, path] : numbered) paths.push_back(std::move(path));
  return paths;
}

// Returns the vector-valued datasets of a part of an episode, including nested groups
// ("goal/position"), ordered by their attributes `offset` if all have one, else by name. Skips
// datasets of more than two dimensions except `pictures`. A single dataset can replace the group.
core::StateLayout PartLayout(const Hdf5Reader& file, const std::string& episode, const char* part,
                             const Pictures& pictures = {}) {
  const std::string path = episode + "/" + part;
  if (!file.Exists(path)) {
    // The full state of a simulator is not an observation of a robot.
    const bool states_alone = std::string_view(part) == "obs" && file.Exists(episode + "/states");
    file.Fail(path, states_alone ? "does not exist: the file holds only simulator states, as "
                                   "robosuite's recorder writes them. Add observations with "
                                   "robomimic's dataset_states_to_obs.py"
                                 : "does not exist");
  }
  int objects = 0;
  std::vector<Key> keys;
  if (CollectKeys(file, path, part, 0, pictures, objects, keys)) {
    std::stable_sort(keys.begin(), keys.end(),
                     [](const Key& a, const Key& b) { return a.offset < b.offset; });
  }
  for (const std::string& name : pictures) {
    if (std::ranges::count(keys, name, &Key::name) == 0) {
      RefuseRequest(file, core::Format("%s/%s", path.c_str(), name.c_str()), "does not exist");
    }
  }
  if (keys.empty()) file.Fail(path, "has no vector-valued dataset");
  core::StateLayout layout;
  std::int64_t size = 0;
  for (const Key& key : keys) {
    size += key.size;
    if (size > core::StateLayout::kMaxStateDim) file.Fail(path, "has too many columns in all");
    if (key.picture.height > 0) {
      layout.Add(key.name, key.picture);
    } else {
      layout.Add(key.name, key.size);
    }
  }
  return layout;
}

// Describes the first difference between an episode's layout and the first episode's.
std::string Difference(const core::StateLayout& found, const core::StateLayout& first) {
  for (const auto& block : first.blocks) {
    const auto same = std::ranges::find(found.blocks, block.name, &core::StateLayout::Block::name);
    if (same == found.blocks.end()) return "lacks '" + block.name + "' of the first episode";
    if (same->size != block.size) {
      return "has " + std::to_string(same->size) + " columns in '" + block.name +
             "', but the first episode has " + std::to_string(block.size);
    }
  }
  for (const auto& block : found.blocks) {
    if (std::ranges::count(first.blocks, block.name, &core::StateLayout::Block::name) == 0) {
      return "has '" + block.name + "', which the first episode lacks";
    }
  }
  return "has shapes or an order of datasets that differ from the first episode's";
}

void CheckPart(const Hdf5Reader& file, const std::string& episode, const char* part,
               const core::StateLayout& layout, const Pictures& pictures = {}) {
  const core::StateLayout found = PartLayout(file, episode, part, pictures);
  if (found != layout) file.Fail(episode + "/" + part, Difference(found, layout));
}

Matrix ReadPart(const Hdf5Reader& file, const std::string& episode, const char* part,
                const core::StateLayout& layout, Eigen::Index rows, const char* count) {
  const std::string path = episode + "/" + part;
  return ReadBlocks(file, file.IsGroup(path) ? path : episode, layout, rows, count);
}

std::string Note(std::size_t episodes, const std::string& what) {
  return "the writer of this file was killed: its " + std::to_string(episodes) +
         (episodes == 1 ? " complete episode is read; " : " complete episodes are read; ") + what +
         ". guard check --repair FILE writes them to a new file";
}

}  // namespace

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
      DFR_THROW_UNLESS(std::abs(u) <= 1.0,
                       "demonstration " << episode << ", step " << t << ": control " << j << " is "
                                        << u << "; files hold controls scaled to [-1, 1]");
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

void CheckLayout(const core::StateLayout& layout, int control_dim) {
  DFR_THROW_UNLESS(layout.state_dim() > 0, "demonstrations need a state layout");
  DFR_THROW_UNLESS(control_dim > 0,
                   "demonstrations need at least one control entry, not " << control_dim);
  for (const auto& block : layout.blocks) {
    const std::string path = "/" + block.name + "/";
    DFR_THROW_UNLESS(path.find("//") == std::string::npos &&
                         path.find("/./") == std::string::npos &&
                         std::ranges::count(block.name, '/') <= kDeepest,
                     "state block '" << block.name
                                     << "' cannot name a dataset: rename it to one or more parts, "
                                        "separated by '/', none of them empty or '.'");
    for (const auto& other : layout.blocks) {
      DFR_THROW_UNLESS(&other == &block || !("/" + other.name + "/").starts_with(path),
                       "state blocks '" << block.name << "' and '" << other.name
                                        << "' cannot name datasets of one group: rename one");
    }
    DFR_THROW_UNLESS(core::IsUtf8(block.name),
                     "the name of the state block '" << block.name << "' is not UTF-8; rename it");
  }
}

Matrix ReadRows(const Hdf5Reader& file, const std::string& path, Eigen::Index rows,
                const char* count) {
  if (!file.Exists(path)) file.Fail(path, "does not exist");
  Matrix values = file.Read(path);
  if (values.rows() != rows) {
    file.Fail(path, "has " + std::to_string(values.rows()) + " rows; " + count + " is " +
                        std::to_string(rows));
  }
  for (Eigen::Index i = 0; i < values.rows(); ++i) {
    for (Eigen::Index j = 0; j < values.cols(); ++j) {
      if (core::IsMeasurable(values(i, j))) continue;
      std::string text = "row " + std::to_string(i) + ", column " + std::to_string(j) + " is " +
                         core::Format("%g", std::abs(values(i, j)));
      if (std::isfinite(values(i, j))) {
        text += core::Format(" in magnitude, where %g is the limit", core::kLargestEntry);
      }
      file.Fail(path, text);
    }
  }
  return values;
}

Matrix ReadBlocks(const Hdf5Reader& file, const std::string& group, const core::StateLayout& layout,
                  Eigen::Index rows, const char* count) {
  file.CheckSize(group, rows, layout.state_dim());
  Matrix values(rows, layout.state_dim());
  for (const auto& block : layout.blocks) {
    const std::string path = group + "/" + block.name;
    const Matrix part = ReadRows(file, path, rows, count);
    if (part.cols() != block.size) {
      file.Fail(path, "has " + std::to_string(part.cols()) + " columns, not " +
                          std::to_string(block.size));
    }
    values.middleCols(block.offset, block.size) = part;
  }
  return values;
}

void EpisodeReader::FindEpisodes(const std::string& group, std::string_view prefix,
                                 const char* states, const char* last) {
  episodes_ = ListEpisodes(group, prefix);
  if (episodes_.empty()) file_.Fail(group.empty() ? "/" : group, "holds no episode");
  LeaveUnfinished(last);
  states_ = states;
  layout_ = PartLayout(file_, episodes_[0], states_, pictures_);
  controls_ = PartLayout(file_, episodes_[0], kActions);
}

// Returns the members of `group`. If the writer was killed while it changed that list, returns
// those of the second list, which is intact. Other programs change only the first list.
std::vector<std::string> EpisodeReader::ListEpisodes(const std::string& group,
                                                     std::string_view prefix) {
  if (!file_.IntegerAttribute("/", Hdf5File::kSecondList)) {
    return NumberedMembers(file_, group, prefix);
  }
  using List = std::optional<std::vector<std::string>>;  // std::nullopt: unreadable
  const auto list = [&](const std::string& from) -> List {
    try {
      std::vector<std::string> episodes = NumberedMembers(file_, from, prefix);
      std::erase_if(episodes, [this](const std::string& path) { return !file_.IsGroup(path); });
      return episodes;
    } catch (const std::runtime_error&) {
      return std::nullopt;
    }
  };
  const auto listed = [&] {
    try {
      return file_.IntegerAttribute(Hdf5File::kSecondList, Hdf5File::kListed);
    } catch (const std::runtime_error&) {
      return std::optional<std::int64_t>();
    }
  };
  List first = list(group);
  List second = list(Hdf5File::kSecondList);
  const bool killed_at_first =
      second && (!first || listed().value_or(std::ssize(*second)) < std::ssize(*second));
  if (!killed_at_first && first && second) return std::move(*first);
  List& intact = killed_at_first ? second : first;
  if (!intact) return {};
  note_ = Note(intact->size(), "the list of episodes was being written");
  return std::move(*intact);
}

void EpisodeReader::LeaveUnfinished(const char* last) {
  if (episodes_.size() < 2) return;
  const std::string episode = episodes_.back();
  try {
    if (file_.IntegerAttribute(episode, last)) return;
  } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): also incomplete
  }
  // Some writers never write this attribute.
  if (!file_.IntegerAttribute(episodes_[0], last)) return;
  episodes_.pop_back();
  note_ = Note(episodes_.size(), episode + ", which was being written, is left out");
}

void EpisodeReader::KeepMasked(const std::string& mask) {
  const std::string path = "mask/" + mask;
  if (!file_.Exists("mask")) file_.Fail("mask", "does not exist: this file has no filter keys");
  if (mask.empty() || !file_.Exists(path)) {
    std::string known;
    for (const std::string& name : file_.Members("mask"))
      known += (known.empty() ? "" : ", ") + name;
    file_.Fail(path, "does not exist; the filter keys of this file are: " + known);
  }
  const auto name_of = [](const std::string& episode) {
    return episode.substr(episode.rfind('/') + 1);  // in either list
  };
  std::set<std::string> known;
  for (const std::string& episode : episodes_) known.insert(name_of(episode));
  std::set<std::string> wanted;
  for (const std::string& name : file_.ReadTexts(path)) {
    if (!known.contains(name)) {
      file_.Fail(path, "names '" + name + "', which is not an episode of this file");
    }
    wanted.insert(name);
  }
  if (wanted.empty()) file_.Fail(path, "names no episode");
  std::erase_if(episodes_,
                [&](const std::string& episode) { return !wanted.contains(name_of(episode)); });
}

core::Trajectory EpisodeReader::Read(int i) const {
  const std::string& episode = name(i);
  CheckPart(file_, episode, states_, layout_, pictures_);
  core::Trajectory trajectory = ReadEpisode(episode);
  trajectory.seed = static_cast<std::uint64_t>(file_.IntegerAttribute(episode, "seed").value_or(0));
  return trajectory;
}

std::string EpisodeReader::FirstActions(const std::string& episode) const {
  CheckPart(file_, episode, kActions, controls_);
  std::string path = episode + "/" + kActions;
  if (file_.IsGroup(path)) path += "/" + controls_.blocks[0].name;
  return path;
}

Matrix EpisodeReader::ReadActions(const std::string& episode, Eigen::Index steps,
                                  const char* count) const {
  CheckPart(file_, episode, kActions, controls_);
  return ReadPart(file_, episode, kActions, controls_, steps, count);
}

Matrix EpisodeReader::ReadStates(const std::string& episode, Eigen::Index rows,
                                 const char* count) const {
  return ReadPart(file_, episode, states_, layout_, rows, count);
}

std::optional<core::Outcome> EpisodeReader::Outcome(const std::string& episode) const {
  const std::optional<std::string> name = file_.TextAttribute(episode, "outcome");
  if (!name) return std::nullopt;
  using enum core::Outcome;
  for (const core::Outcome outcome : {kCompleted, kHalted, kCollided}) {
    if (*name == core::Name(outcome)) return outcome;
  }
  file_.Fail(episode, "outcome '" + *name + "' is unknown");
}

}  // namespace dfr::imitation::internal
