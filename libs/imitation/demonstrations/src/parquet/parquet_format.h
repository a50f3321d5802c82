#pragma once

#include <bit>
#include <cstdint>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <string>
#include <string_view>

/// Numbers and encodings of Apache Parquet's metadata and pages.
namespace dfr::imitation::internal {

static_assert(std::endian::native == std::endian::little);

// Numbers from the format's specification.
enum Type { kBoolean = 0, kInt32 = 1, kInt64 = 2, kFloat = 4, kDouble = 5, kFixedBytes = 7 };
enum Converted { kUint32 = 13, kUint64 = 14 };
constexpr int kLogicalFloat16 = 15;
enum Encoding { kPlain = 0, kPlainDictionary = 2, kRle = 3, kRleDictionary = 8 };
enum Codec { kUncompressed = 0, kSnappy = 1, kZstd = 6 };
enum PageType { kDataPage = 0, kIndexPage = 1, kDictionaryPage = 2, kDataPageV2 = 3 };
enum Repetition { kRequired = 0, kOptional = 1, kRepeated = 2 };

// Internal error; ParquetFile adds the file's name.
class Malformed : public std::runtime_error {
  using std::runtime_error::runtime_error;
};

// Takes bytes from the front of a buffer; never reads beyond its end.
class Bytes {
 public:
  explicit Bytes(std::string_view bytes) : bytes_(bytes) {}

  [[nodiscard]] bool empty() const { return bytes_.empty(); }
  [[nodiscard]] std::size_t left() const { return bytes_.size(); }
  std::string_view Take(std::uint64_t size) {
    if (size > bytes_.size()) throw Malformed("ends in the middle of a value");
    const std::string_view taken = bytes_.substr(0, size);
    bytes_.remove_prefix(size);
    return taken;
  }
  std::uint8_t Byte() { return static_cast<std::uint8_t>(Take(1)[0]); }
  template <typename T>
  T Fixed() {
    T value;
    std::memcpy(&value, Take(sizeof(T)).data(), sizeof(T));
    return value;
  }
  std::uint64_t Varint() {
    std::uint64_t value = 0;
    for (int shift = 0; shift < 64; shift += 7) {
      const std::uint8_t byte = Byte();
      value |= static_cast<std::uint64_t>(byte & 0x7f) << shift;
      if ((byte & 0x80) == 0) return value;
    }
    throw Malformed("holds an integer of more than 64 bits");
  }

 private:
  std::string_view bytes_;
};

// Decoder of Thrift's compact protocol: structs of numbered fields.
class Thrift {
 public:
  enum Kind {
    kStop = 0,
    kTrue = 1,
    kFalse = 2,
    kByte = 3,
    kI16 = 4,
    kI32 = 5,
    kI64 = 6,
    kDoubleKind = 7,
    kBinary = 8,
    kList = 9,
    kSet = 10,
    kMap = 11,
    kStruct = 12
  };

  explicit Thrift(Bytes& bytes) : bytes_(&bytes) {}

  // Calls field(number, kind) for each field of a struct. `field` must read or skip the value.
  template <typename Field>
  void Struct(const Field& field) {
    const Deeper deeper(depth_);
    std::int64_t number = 0;
    while (true) {
      const std::uint8_t head = bytes_->Byte();
      if (head == kStop) return;
      const int delta = head >> 4;
      number = delta != 0 ? number + delta : Integer();
      field(number, static_cast<Kind>(head & 0x0f));
    }
  }
  // Calls element(kind) for each element of the list.
  template <typename Element>
  void List(Kind kind, const Element& element) {
    if (kind != kList && kind != kSet) throw Malformed("has metadata of another type");
    const Deeper deeper(depth_);
    const std::uint8_t head = bytes_->Byte();
    std::uint64_t size = head >> 4;
    if (size == 15) size = bytes_->Varint();
    // Every element takes at least one byte.
    if (size > bytes_->left()) throw Malformed("declares a list longer than its metadata");
    for (std::uint64_t i = 0; i < size; ++i) element(static_cast<Kind>(head & 0x0f));
  }
  std::int64_t Integer() {
    const std::uint64_t zigzag = bytes_->Varint();
    return static_cast<std::int64_t>(zigzag >> 1) ^ -static_cast<std::int64_t>(zigzag & 1);
  }
  std::int64_t Integer(Kind kind) {
    if (kind != kI16 && kind != kI32 && kind != kI64) {
      throw Malformed("has metadata of another type");
    }
    return Integer();
  }
  int Int(Kind kind) {
    const std::int64_t value = Integer(kind);
    if (value < 0 || value > std::numeric_limits<int>::max()) {
      throw Malformed("has a number out of range in its metadata");
    }
    return static_cast<int>(value);
  }
  std::string Text(Kind kind) {
    if (kind != kBinary) throw Malformed("has metadata of another type");
    return std::string(bytes_->Take(bytes_->Varint()));
  }
  void Skip(Kind kind) {
    switch (kind) {
      case kTrue:
      case kFalse:
        return;
      case kByte:
        bytes_->Take(1);
        return;
      case kI16:
      case kI32:
      case kI64:
        bytes_->Varint();
        return;
      case kDoubleKind:
        bytes_->Take(8);
        return;
      case kBinary:
        bytes_->Take(bytes_->Varint());
        return;
      case kList:
      case kSet:
        List(kind, [this](Kind element) { SkipElement(element); });
        return;
      case kMap: {
        const Deeper deeper(depth_);
        const std::uint64_t size = bytes_->Varint();
        if (size == 0) return;
        if (size > bytes_->left()) throw Malformed("declares a map longer than its metadata");
        const std::uint8_t kinds = bytes_->Byte();
        for (std::uint64_t i = 0; i < size; ++i) {
          SkipElement(static_cast<Kind>(kinds >> 4));
          SkipElement(static_cast<Kind>(kinds & 0x0f));
        }
        return;
      }
      case kStruct:
        Struct([this](std::int64_t, Kind inner) { Skip(inner); });
        return;
      default:
        throw Malformed("has metadata of an unknown type");
    }
  }

 private:
  // Limits the nesting of structs. Deeper nesting could overflow the stack; no writer produces it.
  class Deeper {
   public:
    explicit Deeper(int& depth) : depth_(depth) {
      if (++depth_ > 32) throw Malformed("has metadata nested too deeply");
    }
    ~Deeper() { --depth_; }
    Deeper(const Deeper&) = delete;
    Deeper& operator=(const Deeper&) = delete;

   private:
    int& depth_;
  };
  // A Boolean in a list or map takes a byte.
  void SkipElement(Kind kind) {
    if (kind == kTrue || kind == kFalse) {
      bytes_->Take(1);
    } else {
      Skip(kind);
    }
  }

  Bytes* bytes_;
  int depth_ = 0;
};

// Decoder of runs of equal values and of groups of eight bit-packed values.
class RunLength {
 public:
  RunLength(std::string_view bytes, int bit_width) : bytes_(bytes), width_(bit_width) {
    if (bit_width < 0 || bit_width > 32) throw Malformed("declares a bit width above 32");
  }

  std::uint32_t Next() {
    while (run_ == 0 && packed_ == 0) NextRun();
    if (run_ > 0) {
      --run_;
      return value_;
    }
    --packed_;
    while (bits_ < width_) {
      buffer_ |= static_cast<std::uint64_t>(bytes_.Byte()) << bits_;
      bits_ += 8;
    }
    const auto value = static_cast<std::uint32_t>(buffer_ & ((std::uint64_t{1} << width_) - 1));
    buffer_ >>= width_;
    bits_ -= width_;
    return value;
  }

 private:
  void NextRun() {
    // Zero-width values need no bytes.
    if (width_ == 0 && bytes_.empty()) {
      run_ = 1;
      value_ = 0;
      return;
    }
    const std::uint64_t head = bytes_.Varint();
    buffer_ = 0;
    bits_ = 0;
    if ((head & 1) != 0) {
      if ((head >> 1) > (std::uint64_t{1} << 40))
        throw Malformed("declares a run that is too long");
      packed_ = (head >> 1) * 8;
      return;
    }
    run_ = head >> 1;
    value_ = 0;
    for (int byte = 0; byte < (width_ + 7) / 8; ++byte) {
      value_ |= static_cast<std::uint32_t>(bytes_.Byte()) << (8 * byte);
    }
  }

  Bytes bytes_;
  int width_;
  std::uint64_t run_ = 0;
  std::uint64_t packed_ = 0;
  std::uint32_t value_ = 0;
  std::uint64_t buffer_ = 0;
  int bits_ = 0;
};

}  // namespace dfr::imitation::internal
