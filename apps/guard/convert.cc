#include <cstdio>
#include <stdexcept>
#include <string>

#include "commands.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/imitation/minari.h"

namespace dfr::apps::guard {
namespace {

// One episode at a time, whatever the size of the file.
template <typename Writer>
void Copy(const imitation::DemonstrationReader& reader, Writer& writer) {
  for (int i = 0; i < reader.num_episodes(); ++i) {
    try {
      writer.Append(reader.Read(i));
    } catch (const std::invalid_argument& e) {
      throw std::runtime_error(reader.name(i) + ": " + e.what());
    }
  }
}

// <namespace>/<name>-v<version>, which Minari takes from the folders' names.
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

}  // namespace

void RunConvert(const ConvertOptions& options) {
  const auto reader = imitation::OpenDemonstrations(options.demonstrations, options.filter_key);
  if (options.out.extension() == ".hdf5") {
    imitation::RobomimicWriter writer(options.out, reader->layout(), reader->control_dim(),
                                      reader->environment());
    Copy(*reader, writer);
  } else {
    imitation::MinariWriter writer = OpenMinariWriter(options, *reader);
    Copy(*reader, writer);
  }
  std::printf("%s: %d episodes\n", options.out.c_str(), reader->num_episodes());
}

}  // namespace dfr::apps::guard
