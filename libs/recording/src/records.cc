#include "dfr/recording/records.h"

#include <fstream>
#include <ios>
#include <stdexcept>
#include <vector>

namespace dfr::recording {
namespace {

void Add(std::string_view bytes, std::uint64_t& hash) {
  for (const char c : bytes) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3ULL;
}

void AddFile(const std::filesystem::path& path, std::uint64_t& hash) {
  std::ifstream file(path, std::ios::binary);
  std::vector<char> block(std::size_t{1} << 16);
  while (file) {
    file.read(block.data(), static_cast<std::streamsize>(block.size()));
    Add({block.data(), static_cast<std::size_t>(file.gcount())}, hash);
  }
  if (!file.eof()) throw std::runtime_error("cannot read " + path.string());
}

}  // namespace

std::string Checksum(const std::filesystem::path& path) {
  std::uint64_t hash = 0xcbf29ce484222325ULL;
  if (std::filesystem::is_directory(path)) {
    std::map<std::string, std::filesystem::path> files;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(path)) {
      if (entry.is_regular_file()) {
        files[entry.path().lexically_relative(path).generic_string()] = entry.path();
      }
    }
    for (const auto& [name, file] : files) {
      Add(name, hash);
      // Zero bytes separate the name, the size and the content.
      Add(std::string_view("\0", 1), hash);
      Add(std::to_string(std::filesystem::file_size(file)), hash);
      Add(std::string_view("\0", 1), hash);
      AddFile(file, hash);
    }
  } else {
    AddFile(path, hash);
  }
  std::string text(16, '0');
  for (std::size_t i = 0; i < text.size(); ++i) {
    text[text.size() - 1 - i] = "0123456789abcdef"[(hash >> (4 * i)) & 15U];
  }
  return text;
}

}  // namespace dfr::recording
