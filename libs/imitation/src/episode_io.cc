#include "episode_io.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>
#include <utility>

#include "dfr/core/contract.h"

namespace dfr::imitation::internal {
namespace {

using core::Matrix;

struct Key {
  std::int64_t offset;
  std::string name;
  int size;
};

// Groups within groups of observations. More are no format's: a link leads back.
constexpr int kDeepest = 8;

// Appends the datasets below `group`; false where one has no offset.
bool CollectKeys(const Hdf5File& file, const std::string& group, const std::string& prefix,
                 int depth, std::vector<Key>& keys) {
  if (depth > kDeepest) {
    file.Fail(group, "is beyond " + std::to_string(kDeepest) + " groups within groups");
  }
  bool all_have_offsets = true;
  for (const std::string& member : file.Members(group)) {
    std::string path = group;
    path += "/" + member;
    const std::string name = prefix + member;
    if (file.IsGroup(path)) {
      all_have_offsets = CollectKeys(file, path, name + "/", depth + 1, keys) && all_have_offsets;
      continue;
    }
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
  return all_have_offsets;
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
  DFR_THROW_UNLESS(control_dim > 0, "demonstrations need controls, not " << control_dim);
  for (const auto& block : layout.blocks) {
    DFR_THROW_UNLESS(!block.name.empty() && block.name.find('/') == std::string::npos,
                     "state block '" << block.name << "' cannot name a dataset");
  }
}

std::optional<core::Outcome> ParseOutcome(std::string_view name) {
  using core::Outcome;
  for (const Outcome outcome : {Outcome::kCompleted, Outcome::kHalted, Outcome::kCollided}) {
    if (name == core::Name(outcome)) return outcome;
  }
  return std::nullopt;
}

std::vector<std::string> NumberedMembers(const Hdf5File& file, const std::string& group,
                                         std::string_view prefix) {
  const std::string folder = group.empty() ? "" : group + "/";
  std::vector<std::pair<std::int64_t, std::string>> numbered;
  for (const std::string& name : file.Members(group)) {
    std::int64_t number = 0;
    const char* const begin = name.data() + std::min(prefix.size(), name.size());
    const char* const end = name.data() + name.size();
    const auto [stop, error] = std::from_chars(begin, end, number);
    if (!name.starts_with(prefix) || error != std::errc() || stop != end) {
      file.Fail(folder + name, "is not named " + std::string(prefix) + "<number>");
    }
    numbered.emplace_back(number, folder + name);
  }
  std::sort(numbered.begin(), numbered.end());
  std::vector<std::string> paths;
  paths.reserve(numbered.size());
  for (auto& [number, path] : numbered) paths.push_back(std::move(path));
  return paths;
}

Matrix ReadRows(const Hdf5File& file, const std::string& path, Eigen::Index rows,
                const char* count) {
  if (!file.Exists(path)) file.Fail(path, "does not exist");
  Matrix values = file.Read(path);
  if (values.rows() != rows) {
    file.Fail(path, "has " + std::to_string(values.rows()) + " rows; " + count + " is " +
                        std::to_string(rows));
  }
  for (Eigen::Index i = 0; i < values.rows(); ++i) {
    for (Eigen::Index j = 0; j < values.cols(); ++j) {
      if (!std::isfinite(values(i, j))) {
        file.Fail(path, "row " + std::to_string(i) + ", column " + std::to_string(j) + " is " +
                            std::to_string(values(i, j)));
      }
    }
  }
  return values;
}

core::StateLayout ReadLayout(const Hdf5File& file, const std::string& group) {
  if (!file.Exists(group)) file.Fail(group, "does not exist");
  std::vector<Key> keys;
  const bool all_have_offsets = CollectKeys(file, group, "", 0, keys);
  if (keys.empty()) file.Fail(group, "has no vector-valued dataset");
  if (all_have_offsets) {
    std::stable_sort(keys.begin(), keys.end(),
                     [](const Key& a, const Key& b) { return a.offset < b.offset; });
  }
  core::StateLayout layout;
  for (const Key& key : keys) layout.Add(key.name, key.size);
  return layout;
}

Matrix ReadBlocks(const Hdf5File& file, const std::string& group, const core::StateLayout& layout,
                  Eigen::Index rows, const char* count) {
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

}  // namespace dfr::imitation::internal
