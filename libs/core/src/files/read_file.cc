#include "dfr/core/files/read_file.h"

#include <array>
#include <fstream>
#include <new>
#include <stdexcept>
#include <system_error>

namespace dfr::core {

void CheckPlainFile(const std::filesystem::path& path) {
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::status(path, error);
  if (!std::filesystem::exists(status) || std::filesystem::is_regular_file(status)) return;
  const bool folder = std::filesystem::is_directory(status);
  throw std::runtime_error(path.string() +
                           (folder ? ": is a folder" : ": is a pipe or a device, not a file"));
}

void AppendRest(std::istream& in, const std::filesystem::path& path, std::string& bytes) {
  std::array<char, std::size_t{1} << 16> block{};
  try {
    while (in) {
      in.read(block.data(), std::ssize(block));
      bytes.append(block.data(), static_cast<std::size_t>(in.gcount()));
    }
  } catch (const std::bad_alloc&) {
    throw std::runtime_error(path.string() + ": does not fit into memory");
  }
  if (!in.eof()) throw std::runtime_error(path.string() + ": cannot be read to its end");
}

std::string ReadFile(const std::filesystem::path& path) {
  CheckPlainFile(path);
  std::ifstream in(path, std::ios::binary);
  if (!in) throw std::runtime_error(path.string() + ": cannot be read");
  std::string bytes;
  AppendRest(in, path, bytes);
  return bytes;
}

}  // namespace dfr::core
