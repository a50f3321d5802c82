#include "text_file.h"

#include <fstream>
#include <sstream>
#include <stdexcept>

namespace dfr::experiment::internal {

std::string ReadFile(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  std::ostringstream bytes;
  bytes << in.rdbuf();
  if (!in) throw std::runtime_error(path.string() + ": cannot be read");
  return bytes.str();
}

}  // namespace dfr::experiment::internal
