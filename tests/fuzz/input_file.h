#pragma once

#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <span>
#include <string>
#include <string_view>

namespace dfr::fuzz {

/// Returns a file with the given content, for readers that take a path. The whole process uses one
/// file.
inline std::filesystem::path InputFile(std::string_view bytes) {
  // The file is in /dev/shm if that is writable, because a disk would take most of the time.
  static const std::filesystem::path path =
      (access("/dev/shm", W_OK) == 0 ? "/dev/shm" : std::filesystem::temp_directory_path()) /
      std::filesystem::path("dfr_fuzz_" + std::to_string(getpid()));
  static const bool registered = std::atexit([] {
                                   std::error_code ignored;
                                   std::filesystem::remove(path, ignored);
                                 }) == 0;
  static_cast<void>(registered);
  std::ofstream(path, std::ios::binary | std::ios::trunc)
      .write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  return path;
}

inline std::string_view AsText(const std::uint8_t* data, std::size_t size) {
  return size == 0 ? std::string_view()
                   : std::string_view(reinterpret_cast<const char*>(data), size);
}

/// Returns an archive of this kind and version around arbitrary values, with a valid checksum that
/// the reader accepts (see libs/core/src/files/archive.cc).
inline std::string Archive(std::string_view kind, std::int64_t version, std::string_view values) {
  const auto number = [](auto value) {
    return std::string(reinterpret_cast<const char*>(&value), sizeof value);
  };
  std::string bytes("dfr\x1a\r\n\x01\n");
  bytes += number(static_cast<std::uint64_t>(kind.size()));
  bytes += kind;
  bytes += number(version);
  bytes += values;
  std::uint64_t hash = 0xcbf29ce484222325u;
  for (const char c : bytes) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
  return bytes + number(hash);
}

}  // namespace dfr::fuzz
