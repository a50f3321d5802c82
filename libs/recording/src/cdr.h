#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "bytes.h"

namespace dfr::recording::internal {

/// Appends a message in ROS 2's encoding (plain CDR, little-endian): each number is aligned to its
/// size, counted from the end of the four-byte encoding header.
class CdrWriter {
 public:
  explicit CdrWriter(std::string& out) : out_(out), bytes_(out) {
    bytes_.Bytes(std::string_view("\0\1\0\0", 4));
    start_ = out.size();
  }

  template <typename T>
  void Number(T value) {
    out_.append((sizeof value - (out_.size() - start_) % sizeof value) % sizeof value, '\0');
    bytes_.Number(value);
  }
  void Bool(bool value) { Number<std::uint8_t>(value ? 1 : 0); }
  void Text(std::string_view text) {
    Number(static_cast<std::uint32_t>(text.size() + 1));
    bytes_.Bytes(text);
    bytes_.Number('\0');
  }
  void Numbers(std::span<const double> values) {
    Number(static_cast<std::uint32_t>(values.size()));
    for (const double value : values) Number(value);
  }
  void Bytes(std::string_view bytes) {
    Number(static_cast<std::uint32_t>(bytes.size()));
    bytes_.Bytes(bytes);
  }

 private:
  std::string& out_;
  ByteWriter bytes_;
  std::size_t start_ = 0;
};

/// Reads CdrWriter's encoding. Check complete() once, at the end.
class CdrReader {
 public:
  explicit CdrReader(std::string_view message) : reader_(message) {
    encoding_ok_ = reader_.Bytes(4) == std::string_view("\0\1\0\0", 4);
  }

  template <typename T>
  T Number() {
    Align(sizeof(T));
    return reader_.Number<T>();
  }
  bool Bool() { return Number<std::uint8_t>() != 0; }
  std::string_view Text() {
    const auto size = Number<std::uint32_t>();
    const std::string_view text = reader_.Bytes(size);
    if (text.empty() || text.back() != '\0') {
      encoding_ok_ = false;
      return {};
    }
    return text.substr(0, text.size() - 1);
  }
  /// Reads `count` numbers into the front of `values`. Returns false if `values` has too few
  /// entries or the message ends early.
  bool Numbers(std::span<double> values, std::size_t& count) {
    count = Number<std::uint32_t>();
    if (count > values.size()) return encoding_ok_ = false;
    for (double& value : values.first(count)) value = Number<double>();
    return ok();
  }
  std::string_view Bytes() { return reader_.Bytes(Number<std::uint32_t>()); }

  [[nodiscard]] std::size_t position() const noexcept { return reader_.position(); }
  /// True if all data were present and none remain.
  [[nodiscard]] bool complete() const noexcept { return ok() && reader_.at_end(); }

 private:
  [[nodiscard]] bool ok() const noexcept { return encoding_ok_ && reader_.ok(); }
  void Align(std::size_t size) {
    const std::size_t used = (reader_.position() - 4) % size;
    if (used != 0) reader_.Bytes(size - used);
  }

  ByteReader reader_;
  bool encoding_ok_ = false;
};

}  // namespace dfr::recording::internal
