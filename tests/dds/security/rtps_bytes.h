#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace dfr::test {

/// An RTPS message.
using Bytes = std::vector<std::uint8_t>;

inline Bytes Header() {
  Bytes bytes = {'R', 'T', 'P', 'S', 2, 3, 1, 15};
  bytes.insert(bytes.end(), 12, 1);
  return bytes;
}

// Adds a submessage with `length` zero bytes of content, little-endian by default.
inline void Add(Bytes& bytes, std::uint8_t kind, std::uint16_t length, bool little = true) {
  const auto low = static_cast<std::uint8_t>(length & 255U);
  const auto high = static_cast<std::uint8_t>(length >> 8U);
  bytes.insert(bytes.end(),
               {kind, static_cast<std::uint8_t>(little), little ? low : high, little ? high : low});
  bytes.insert(bytes.end(), length, 0);
}

inline void AddNumber(Bytes& bytes, std::uint32_t number, int size, bool little) {
  for (int k = 0; k < size; ++k) {
    bytes.push_back(static_cast<std::uint8_t>(
        number >> (8U * static_cast<unsigned>(little ? k : size - 1 - k))));
  }
}

// Header and content of a sample.
struct Sample {
  bool little = true;
  bool fragments = false;
  std::uint8_t flags = 4;           // data flag; key flag in fragments
  std::uint32_t to_parameters = 0;  // 0: the correct value
  Bytes parameters = {};
  std::size_t payload = 20;
  std::uint32_t first = 1;
  std::uint32_t count = 1;
  std::uint32_t size = 1000;
  std::uint32_t whole = 20;
  bool announces = false;  // announces a participant
};

// Adds the sample as a submessage. With `to_end`, the submessage declares no length and extends to
// the end of the message.
inline void Add(Bytes& bytes, const Sample& sample, bool to_end = false) {
  Bytes content = {0, 0};
  const std::uint32_t right = sample.fragments ? 28 : 16;
  AddNumber(content, sample.to_parameters == 0 ? right : sample.to_parameters, 2, sample.little);
  const Bytes writer = sample.announces ? Bytes{0, 1, 0, 0xc2} : Bytes{0, 0, 3, 0xc2};
  content.insert(content.end(), 4, 0);  // any reader
  content.insert(content.end(), writer.begin(), writer.end());
  content.insert(content.end(), 4, 0);
  AddNumber(content, 7, 4, sample.little);
  if (sample.fragments) {
    AddNumber(content, sample.first, 4, sample.little);
    AddNumber(content, sample.count, 2, sample.little);
    AddNumber(content, sample.size, 2, sample.little);
    AddNumber(content, sample.whole, 4, sample.little);
  }
  content.insert(content.end(), sample.parameters.begin(), sample.parameters.end());
  content.insert(content.end(), sample.payload, 7);
  const auto endian = static_cast<std::uint8_t>(sample.little);
  bytes.push_back(sample.fragments ? 0x16 : 0x15);
  bytes.push_back(sample.flags | endian);
  AddNumber(bytes, to_end ? 0 : static_cast<std::uint32_t>(content.size()), 2, sample.little);
  bytes.insert(bytes.end(), content.begin(), content.end());
}

}  // namespace dfr::test
