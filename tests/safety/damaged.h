#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

#include "dfr/core/random.h"

namespace dfr::test {

/// Returns the content of an archive with its checksum appended.
inline std::string WithChecksum(std::string content) {
  std::uint64_t checksum = 0xcbf29ce484222325u;  // FNV-1a
  for (const char c : content) {
    checksum = (checksum ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
  }
  return content.append(reinterpret_cast<const char*>(&checksum), sizeof checksum);
}

/// Returns the archive with `other` in place of the first number with the bits of `value`, and with
/// a valid checksum; "" if there is no such number.
inline std::string WithNumber(const std::string& archive, double value, double other) {
  std::string changed = archive.substr(0, archive.size() - sizeof(std::uint64_t));
  const std::size_t at =
      changed.find(std::string_view(reinterpret_cast<const char*>(&value), sizeof value));
  if (at == std::string::npos) return {};
  changed.replace(at, sizeof other, reinterpret_cast<const char*>(&other), sizeof other);
  return WithChecksum(std::move(changed));
}

/// Returns the archive with one to three bytes changed, sometimes without its end, and with a valid
/// checksum, as another program might write it.
inline std::string Damaged(const std::string& archive, core::Random& random) {
  std::string damaged = archive.substr(0, archive.size() - sizeof(std::uint64_t));
  for (std::uint64_t n = 1 + random.Below(3); n > 0; --n) {
    damaged[random.Below(damaged.size())] = static_cast<char>(random.Below(256));
  }
  if (random.Below(8) == 0) damaged.resize(random.Below(damaged.size()));
  return WithChecksum(std::move(damaged));
}

}  // namespace dfr::test
