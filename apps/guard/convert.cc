#include <cstdio>
#include <filesystem>
#include <set>
#include <span>
#include <stdexcept>
#include <string>
#include <system_error>
#include <vector>

#include "commands.h"
#include "dfr/core/features/absolute_actions.h"
#include "dfr/core/text/format.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/imitation/minari.h"

namespace dfr::apps::guard {
namespace {

// Converts one episode at a time, for files of any size.
template <typename Writer>
void Copy(const imitation::DemonstrationReader& reader, const std::filesystem::path& path,
          std::span<const core::AbsoluteAction> absolute, Writer& writer) {
  for (int i = 0; i < reader.num_episodes(); ++i) {
    core::Trajectory episode = reader.Read(i);
    core::ToDifferences(absolute, episode);
    try {
      writer.Append(episode);
    } catch (const std::invalid_argument& e) {
      throw std::runtime_error(path.string() + ": " + reader.name(i) + ": " + e.what());
    }
  }
}

// Returns the dataset's id, <namespace>/<name>-v<version>, from the names of the last two folders.
std::string DatasetId(const std::filesystem::path& folder) {
  const std::filesystem::path whole = std::filesystem::absolute(folder).lexically_normal();
  const std::filesystem::path named = whole.has_filename() ? whole : whole.parent_path();
  const std::string space = named.parent_path().filename().string();
  return space.empty() ? named.filename().string() : space + "/" + named.filename().string();
}

imitation::MinariWriter OpenMinariWriter(const ConvertOptions& options,
                                         const imitation::DemonstrationReader& reader) {
  try {
    return {options.out, options.id.empty() ? DatasetId(options.out) : options.id, reader.layout(),
            reader.control_dim(), reader.environment()};
  } catch (const std::invalid_argument& e) {
    throw std::runtime_error(options.out.string() + ": " + e.what() +
                             (options.id.empty() ? "; give --id, or another folder" : ""));
  }
}

// Returns the entries of actions that --differences converts. Prints the result for each entry.
std::vector<core::AbsoluteAction> FindPositions(const imitation::DemonstrationReader& reader,
                                                const std::filesystem::path& path) {
  core::ActionAnalysis analysis(reader.layout().state_dim(), reader.control_dim());
  for (int i = 0; i < reader.num_episodes(); ++i) analysis.Add(reader.Read(i));
  std::vector<core::AbsoluteAction> absolute = analysis.Absolute();
  if (absolute.empty()) {
    throw std::runtime_error(path.string() +
                             ": no action takes the values of a state's entry, so --differences "
                             "has nothing to convert");
  }
  std::set<int> left;
  for (int k = 0; k < reader.control_dim(); ++k) left.insert(k);
  for (const core::AbsoluteAction& entry : absolute) {
    const std::string modulo =
        entry.period > 0.0 ? core::Format(", modulo %.4g", entry.period) : std::string();
    Print("action %d becomes %s minus %s%s\n", entry.action,
          entry.leads ? "the action" : "its next value",
          core::EntryName(reader.layout(), entry.state).c_str(), modulo.c_str());
    left.erase(entry.action);
  }
  for (const int k : left) {
    Print(
        "action %d stays as recorded: it follows no entry of the state. Does zero hold it "
        "still?\n",
        k);
  }
  return absolute;
}

// Returns the file with the episodes of a robomimic file or a Minari dataset.
std::filesystem::path EpisodesOf(const std::filesystem::path& path) {
  std::error_code error;
  return std::filesystem::is_directory(path, error) ? path / "data" / "main_data.hdf5" : path;
}

}  // namespace

void RunConvert(const ConvertOptions& options) {
  std::error_code error;
  if (std::filesystem::equivalent(EpisodesOf(options.demonstrations), EpisodesOf(options.out),
                                  error)) {
    throw std::runtime_error(options.out.string() +
                             ": would overwrite the episodes to convert; name another output");
  }
  const auto reader = imitation::OpenDemonstrations(options.demonstrations, options.filter_key);
  if (!reader->note().empty()) Print("%s\n", reader->note().c_str());
  std::vector<core::AbsoluteAction> absolute;
  if (options.differences) absolute = FindPositions(*reader, options.demonstrations);
  if (options.out.extension() == ".hdf5") {
    imitation::RobomimicWriter writer(options.out, reader->layout(), reader->control_dim(),
                                      reader->environment());
    writer.CopyOrigin(*reader);
    Copy(*reader, options.demonstrations, absolute, writer);
  } else {
    imitation::MinariWriter writer = OpenMinariWriter(options, *reader);
    Copy(*reader, options.demonstrations, absolute, writer);
  }
  Print("%s: %d episodes\n", options.out.c_str(), reader->num_episodes());
}

}  // namespace dfr::apps::guard
