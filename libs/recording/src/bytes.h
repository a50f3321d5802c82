#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <type_traits>

namespace dfr::recording::internal {

static_assert(std::endian::native == std::endian::little, "files are little-endian");

/// Appends numbers and strings in MCAP's encoding: little-endian, without padding.
class ByteWriter {
 public:
  explicit ByteWriter(std::string& out) : out_(out) {}

  template <typename T>
  void Number(T value) {
    static_assert(std::is_arithmetic_v<T>);
    char bytes[sizeof value];
    std::memcpy(bytes, &value, sizeof value);
    out_.append(bytes, sizeof value);
  }
  void Bytes(std::string_view bytes) { out_.append(bytes); }
  /// Appends a string, prefixed with its size.
  void Text(std::string_view text) {
    Number(static_cast<std::uint32_t>(text.size()));
    Bytes(text);
  }
  /// Overwrites a number written earlier.
  template <typename T>
  void NumberAt(std::size_t position, T value) {
    std::memcpy(out_.data() + position, &value, sizeof value);
  }
  [[nodiscard]] std::size_t position() const noexcept { return out_.size(); }

 private:
  std::string& out_;
};

/// Reads MCAP's encoding from memory. Reading beyond the end returns zeros and makes ok() false:
/// callers check once, at the end.
class ByteReader {
 public:
  explicit ByteReader(std::string_view bytes) : bytes_(bytes) {}

  template <typename T>
  T Number() {
    T value{};
    const std::string_view bytes = Bytes(sizeof value);
    if (bytes.size() == sizeof value) std::memcpy(&value, bytes.data(), sizeof value);
    return value;
  }
  std::string_view Bytes(std::uint64_t size) {
    if (size > bytes_.size() - position_) {
      ok_ = false;
      position_ = bytes_.size();
      return {};
    }
    const std::string_view bytes = bytes_.substr(position_, size);
    position_ += size;
    return bytes;
  }
  std::string_view Text() { return Bytes(Number<std::uint32_t>()); }
  [[nodiscard]] bool ok() const noexcept { return ok_; }
  [[nodiscard]] bool at_end() const noexcept { return position_ == bytes_.size(); }
  [[nodiscard]] std::size_t position() const noexcept { return position_; }

 private:
  std::string_view bytes_;
  std::size_t position_ = 0;
  bool ok_ = true;
};

}  // namespace dfr::recording::internal
