#pragma once

#include <cstdint>
#include <string>

#include "dfr/core/random.h"

namespace dfr::test {

/// Returns the archive with one to three bytes changed, sometimes without its end, and with a valid
/// checksum, as another program might write it.
inline std::string Damaged(const std::string& archive, core::Random& random) {
  std::string damaged = archive.substr(0, archive.size() - sizeof(std::uint64_t));
  for (std::uint64_t n = 1 + random.Below(3); n > 0; --n) {
    damaged[random.Below(damaged.size())] = static_cast<char>(random.Below(256));
  }
  if (random.Below(8) == 0) damaged.resize(random.Below(damaged.size()));
  std::uint64_t checksum = 0xcbf29ce484222325u;  // FNV-1a
  for (const char c : damaged) {
    checksum = (checksum ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
  }
  return damaged.append(reinterpret_cast<const char*>(&checksum), sizeof checksum);
}

}  // namespace dfr::test
