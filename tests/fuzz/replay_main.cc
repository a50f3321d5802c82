// fuzz_replay TARGET [FOLDER...]: runs a fuzz target on the files of the folders instead of
// libFuzzer's inputs. One program has all targets, and each is an ordinary test.
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <string>
#include <vector>

#include "tests/fuzz/target.h"

namespace {

std::map<std::string, dfr::fuzz::Target>& Targets() {
  static std::map<std::string, dfr::fuzz::Target> targets;
  return targets;
}

}  // namespace

bool dfr::fuzz::AddTarget(const char* name, Target target) {
  return Targets().emplace(name, target).second;
}

int main(int argc, char** argv) try {
  const auto target = Targets().find(argc > 1 ? argv[1] : "");
  if (target == Targets().end()) {
    std::fprintf(stderr, "usage: fuzz_replay TARGET [FOLDER...]\nTargets:");
    for (const auto& [name, unused] : Targets()) std::fprintf(stderr, " %s", name.c_str());
    std::fprintf(stderr, "\n");
    return 2;
  }
  int files = 0;
  for (int i = 2; i < argc; ++i) {
    if (!std::filesystem::exists(argv[i])) continue;
    for (const auto& entry : std::filesystem::directory_iterator(argv[i])) {
      std::ifstream in(entry.path(), std::ios::binary);
      const std::vector<char> bytes{std::istreambuf_iterator<char>(in), {}};
      target->second(reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size());
      ++files;
    }
  }
  // Finally runs the target on empty input.
  const std::uint8_t none = 0;
  target->second(&none, 0);
  std::printf("%d files\n", files);
  return EXIT_SUCCESS;
} catch (const std::exception& e) {
  std::fprintf(stderr, "%s\n", e.what());
  return EXIT_FAILURE;
}
