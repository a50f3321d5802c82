#pragma once

#include <cstdint>
#include <string_view>

namespace dfr::recording::internal {

/// CRC-32 as in zlib and MCAP (polynomial 0xEDB88320). `crc` is the result for the preceding bytes.
[[nodiscard]] std::uint32_t Crc32(std::string_view bytes, std::uint32_t crc = 0) noexcept;

}  // namespace dfr::recording::internal
