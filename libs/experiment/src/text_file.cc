#include "text_file.h"

#include <fstream>
#include <sstream>
#include <stdexcept>
#include <system_error>

namespace dfr::experiment::internal {

void ReplaceFile(const std::filesystem::path& path, std::string_view text) {
  std::filesystem::path temporary = path;
  temporary += ".part";
  {
    std::ofstream out(temporary, std::ios::binary);
    out.write(text.data(), static_cast<std::streamsize>(text.size()));
    out.close();
    if (!out) {
      throw std::runtime_error(
          temporary.string() +
          ": cannot be written; check that the folder exists and that the disk is not full");
    }
  }
  std::error_code error;
  std::filesystem::rename(temporary, path, error);
  if (error) throw std::runtime_error(path.string() + ": " + error.message());
}

std::string ReadFile(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  std::ostringstream bytes;
  bytes << in.rdbuf();
  if (!in) throw std::runtime_error(path.string() + ": cannot be read");
  return bytes.str();
}

}  // namespace dfr::experiment::internal
