#include "parquet_file.h"

#include <snappy.h>
#include <zstd.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <stdexcept>
#include <utility>

namespace dfr::imitation::internal {
namespace {

static_assert(std::endian::native == std::endian::little);

// Numbers from the format's specification.
enum Type { kBoolean = 0, kInt32 = 1, kInt64 = 2, kFloat = 4, kDouble = 5, kFixedBytes = 7 };
enum Converted { kUint32 = 13, kUint64 = 14 };
constexpr int kLogicalFloat16 = 15;
enum Encoding { kPlain = 0, kPlainDictionary = 2, kRle = 3, kRleDictionary = 8 };
enum Codec { kUncompressed = 0, kSnappy = 1, kZstd = 6 };
enum PageType { kDataPage = 0, kIndexPage = 1, kDictionaryPage = 2, kDataPageV2 = 3 };
enum Repetition { kRequired = 0, kOptional = 1, kRepeated = 2 };

std::string NameOf(int number, std::initializer_list<const char*> names) {
  return number >= 0 && number < static_cast<int>(names.size())
             ? names.begin()[number]
             : "number " + std::to_string(number);
}

std::string TypeName(int type) {
  return NameOf(type, {"BOOLEAN", "INT32", "INT64", "INT96", "FLOAT", "DOUBLE", "BYTE_ARRAY",
                       "FIXED_LEN_BYTE_ARRAY"});
}
std::string EncodingName(int encoding) {
  return NameOf(encoding, {"PLAIN", "1", "PLAIN_DICTIONARY", "RLE", "BIT_PACKED",
                           "DELTA_BINARY_PACKED", "DELTA_LENGTH_BYTE_ARRAY", "DELTA_BYTE_ARRAY",
                           "RLE_DICTIONARY", "BYTE_STREAM_SPLIT"});
}
std::string CodecName(int codec) {
  return NameOf(codec,
                {"UNCOMPRESSED", "SNAPPY", "GZIP", "LZO", "BROTLI", "LZ4", "ZSTD", "LZ4_RAW"});
}

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
  // Limits the nesting of structs. More levels than any writer produces are an attack on the stack.
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
  // A truth value in a list or map takes a byte.
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

// Runs of equal values, and groups of eight bit-packed values.
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

std::string Decompress(int codec, std::string_view compressed, std::int64_t size,
                       core::ReadBudget& budget) {
  if (size < 0 || !budget.Take(static_cast<std::uint64_t>(size), 1)) {
    throw Malformed("declares a page of " + std::to_string(size) +
                    " bytes, too many for a file of this size");
  }
  const auto bytes = static_cast<std::size_t>(size);
  const char* const wrong = "has a page that does not decompress to the size it claims";
  switch (codec) {
    case kUncompressed:
      if (compressed.size() != bytes) throw Malformed(wrong);
      return std::string(compressed);
    case kSnappy: {
      std::size_t claimed = 0;
      if (!snappy::GetUncompressedLength(compressed.data(), compressed.size(), &claimed) ||
          claimed != bytes) {
        throw Malformed(wrong);
      }
      std::string page(bytes, '\0');
      if (!snappy::RawUncompress(compressed.data(), compressed.size(), page.data())) {
        throw Malformed(wrong);
      }
      return page;
    }
    case kZstd: {
      std::string page(bytes, '\0');
      const std::size_t got =
          ZSTD_decompress(page.data(), bytes, compressed.data(), compressed.size());
      if (ZSTD_isError(got) != 0 || got != bytes) throw Malformed(wrong);
      return page;
    }
    default:
      throw Malformed(
          "is compressed with " + CodecName(codec) +
          "; uncompressed, SNAPPY and ZSTD can be read: write it again with one of these");
  }
}

int BitWidth(int max_level) { return std::bit_width(static_cast<unsigned>(max_level)); }

struct PageHeader {
  int type = -1;
  std::int64_t uncompressed_size = 0;
  std::int64_t compressed_size = 0;
  int num_values = 0;
  int encoding = -1;
  int repetition_bytes = 0;  // version 2 only
  int definition_bytes = 0;
  bool is_compressed = true;
};

PageHeader ReadPageHeader(Bytes& bytes) {
  PageHeader header;
  Thrift thrift(bytes);
  using Kind = Thrift::Kind;
  thrift.Struct([&](std::int64_t field, Kind kind) {
    if (field == 1) {
      header.type = thrift.Int(kind);
    } else if (field == 2) {
      header.uncompressed_size = thrift.Int(kind);
    } else if (field == 3) {
      header.compressed_size = thrift.Int(kind);
    } else if ((field == 5 || field == 7 || field == 8) && kind == Thrift::kStruct) {
      const bool version_2 = field == 8;
      thrift.Struct([&](std::int64_t inner, Kind inner_kind) {
        if (inner == 1) {
          header.num_values = thrift.Int(inner_kind);
        } else if (inner == (version_2 ? 4 : 2)) {
          header.encoding = thrift.Int(inner_kind);
        } else if (version_2 && inner == 5) {
          header.definition_bytes = thrift.Int(inner_kind);
        } else if (version_2 && inner == 6) {
          header.repetition_bytes = thrift.Int(inner_kind);
        } else if (version_2 && inner == 7) {
          header.is_compressed = inner_kind == Thrift::kTrue;
        } else {
          thrift.Skip(inner_kind);
        }
      });
    } else {
      thrift.Skip(kind);
    }
  });
  return header;
}

// IEEE 754's binary16.
double HalfToDouble(std::uint16_t bits) {
  const double sign = (bits & 0x8000) != 0 ? -1.0 : 1.0;
  const int exponent = (bits >> 10) & 0x1f;
  const double fraction = bits & 0x3ff;
  if (exponent == 0) return sign * std::ldexp(fraction, -24);
  if (exponent < 0x1f) return sign * std::ldexp(1024.0 + fraction, exponent - 25);
  return fraction == 0.0 ? sign * std::numeric_limits<double>::infinity()
                         : std::numeric_limits<double>::quiet_NaN();
}

bool IsNumeric(const ParquetFile::Leaf& leaf) {
  return leaf.type == kBoolean || leaf.type == kInt32 || leaf.type == kInt64 ||
         leaf.type == kFloat || leaf.type == kDouble || leaf.is_half;
}

// Decodes consecutive values, without the levels.
std::vector<double> DecodePlain(const ParquetFile::Leaf& leaf, Bytes& bytes, std::int64_t count) {
  std::vector<double> values;
  const auto fixed = [&]<typename T>(T) {
    if (static_cast<std::uint64_t>(count) > bytes.left() / sizeof(T)) {
      throw Malformed("ends in the middle of a page");
    }
    values.reserve(static_cast<std::size_t>(count));
    for (std::int64_t i = 0; i < count; ++i) {
      values.push_back(static_cast<double>(bytes.Fixed<T>()));
    }
  };
  switch (leaf.type) {
    case kBoolean:
      if (static_cast<std::uint64_t>(count) > 8 * bytes.left()) {
        throw Malformed("ends in the middle of a page");
      }
      for (std::int64_t i = 0; i < count; i += 8) {
        const std::uint8_t byte = bytes.Byte();
        for (std::int64_t bit = 0; bit < std::min<std::int64_t>(8, count - i); ++bit) {
          values.push_back((byte >> bit) & 1);
        }
      }
      break;
    case kInt32:
      leaf.is_unsigned ? fixed(std::uint32_t{}) : fixed(std::int32_t{});
      break;
    case kInt64:
      leaf.is_unsigned ? fixed(std::uint64_t{}) : fixed(std::int64_t{});
      break;
    case kFloat:
      fixed(float{});
      break;
    case kDouble:
      fixed(double{});
      break;
    default:  // two-byte float, as IsNumeric() checked
      fixed(std::uint16_t{});
      for (double& value : values) value = HalfToDouble(static_cast<std::uint16_t>(value));
  }
  return values;
}

}  // namespace

// Reads the metadata at the end of a file.
class FooterParser {
 public:
  FooterParser(ParquetFile& file, Bytes& bytes)
      : file_(&file), thrift_(bytes), budget_(file.budget()) {}

  void Parse() {
    thrift_.Struct([this](std::int64_t field, Thrift::Kind kind) {
      if (field == 2) {
        thrift_.List(kind, [this](Thrift::Kind) { elements_.push_back(ReadElement()); });
      } else if (field == 4) {
        MakeLeaves();
        thrift_.List(kind, [this](Thrift::Kind) { ReadRowGroup(); });
      } else {
        thrift_.Skip(kind);
      }
    });
  }

 private:
  struct Element {
    int type = -1;
    int length = 0;  // length of a fixed-size value
    int repetition = kRequired;
    std::string name;
    int children = 0;
    int converted = -1;
    std::int64_t logical = 0;  // field of Parquet's union LogicalType
  };

  Element ReadElement() {
    Element element;
    thrift_.Struct([&](std::int64_t field, Thrift::Kind kind) {
      if (field == 1) {
        element.type = thrift_.Int(kind);
      } else if (field == 2) {
        element.length = thrift_.Int(kind);
      } else if (field == 3) {
        element.repetition = thrift_.Int(kind);
      } else if (field == 4) {
        element.name = thrift_.Text(kind);
      } else if (field == 5) {
        element.children = thrift_.Int(kind);
      } else if (field == 6) {
        element.converted = thrift_.Int(kind);
      } else if (field == 10 && kind == Thrift::kStruct) {
        thrift_.Struct([&](std::int64_t which, Thrift::Kind inner) {
          element.logical = which;
          thrift_.Skip(inner);
        });
      } else {
        thrift_.Skip(kind);
      }
    });
    return element;
  }

  // The tree of elements is in depth-first order, starting with the root.
  void MakeLeaves() {
    if (!file_->leaves_.empty() || elements_.empty()) throw Malformed("has no schema");
    next_ = 1;
    for (int child = 0; child < elements_[0].children; ++child) {
      if (next_ >= elements_.size()) throw Malformed("has a schema that ends too early");
      file_->names_.push_back(elements_[next_].name);
      AddLeaves({.column = elements_[next_].name, .path = ""}, 0);
    }
  }

  void AddLeaves(ParquetFile::Leaf leaf, int depth) {
    if (next_ >= elements_.size() || depth > 16) throw Malformed("has a schema that is not a tree");
    const Element& element = elements_[next_++];
    leaf.path += (leaf.path.empty() ? "" : ".") + element.name;
    if (element.repetition != kRequired) ++leaf.max_definition;
    if (element.repetition == kRepeated) {
      ++leaf.max_repetition;
      leaf.repeated_definition = leaf.max_definition;
    }
    // Every leaf stores the names above it again.
    if (!budget_.Take(1, sizeof leaf + leaf.column.size() + leaf.path.size())) {
      throw Malformed("has a schema with too many names for a file of this size");
    }
    if (element.children == 0) {
      leaf.type = element.type;
      leaf.is_unsigned = element.converted == kUint32 || element.converted == kUint64;
      leaf.is_half =
          element.type == kFixedBytes && element.length == 2 && element.logical == kLogicalFloat16;
      file_->leaves_.push_back(leaf);
      return;
    }
    for (int child = 0; child < element.children; ++child) AddLeaves(leaf, depth + 1);
  }

  void ReadRowGroup() {
    ParquetFile::RowGroup group;
    thrift_.Struct([&](std::int64_t field, Thrift::Kind kind) {
      if (field == 1) {
        thrift_.List(kind, [&](Thrift::Kind) { group.chunks.push_back(ReadChunk()); });
      } else if (field == 3) {
        group.num_rows = thrift_.Integer(kind);
      } else {
        thrift_.Skip(kind);
      }
    });
    if (group.chunks.size() != file_->leaves_.size()) {
      throw Malformed("has a row group whose columns differ from its schema");
    }
    if (group.num_rows < 0) throw Malformed("declares a negative number of rows");
    file_->row_groups_.push_back(std::move(group));
  }

  ParquetFile::Chunk ReadChunk() {
    ParquetFile::Chunk chunk;
    thrift_.Struct([&](std::int64_t field, Thrift::Kind kind) {
      if (field == 1) throw Malformed("keeps its columns in other files");
      if (field == 3 && kind == Thrift::kStruct) {
        ReadColumn(chunk);
      } else {
        thrift_.Skip(kind);
      }
    });
    return chunk;
  }

  void ReadColumn(ParquetFile::Chunk& chunk) {
    std::int64_t dictionary = 0;
    thrift_.Struct([&](std::int64_t field, Thrift::Kind kind) {
      if (field == 4) {
        chunk.codec = thrift_.Int(kind);
      } else if (field == 5) {
        chunk.num_values = thrift_.Integer(kind);
      } else if (field == 7) {
        chunk.size = thrift_.Integer(kind);
      } else if (field == 9) {
        chunk.start = thrift_.Integer(kind);
      } else if (field == 11) {
        dictionary = thrift_.Integer(kind);
      } else {
        thrift_.Skip(kind);
      }
    });
    // Some writers use 0 for "no dictionary".
    if (dictionary > 0) chunk.start = std::min(chunk.start, dictionary);
  }

  ParquetFile* file_;
  Thrift thrift_;
  std::vector<Element> elements_;
  std::size_t next_ = 0;
  core::ReadBudget budget_;
};

// Decodes the pages of one column in one row group.
class ChunkDecoder {
 public:
  ChunkDecoder(const ParquetFile::Leaf& leaf, const ParquetFile::Chunk& chunk,
               std::int64_t num_rows, const core::ReadBudget& budget)
      : leaf_(&leaf), chunk_(&chunk), num_rows_(num_rows), budget_(budget) {}

  ParquetColumn Decode(std::string_view data) {
    if (leaf_->max_repetition > 1) throw Malformed("has lists within lists");
    if (!IsNumeric(*leaf_)) {
      throw Malformed("is of type " + TypeName(leaf_->type) + ", not numeric");
    }
    const std::int64_t most = std::max(chunk_->num_values, num_rows_);
    if (chunk_->num_values < 0 ||
        !budget_.Take(static_cast<std::uint64_t>(most), sizeof(double) + sizeof(std::int64_t))) {
      throw Malformed("declares " + std::to_string(most) +
                      " values in a row group, too many for a file of this size");
    }
    Bytes bytes(data);
    std::int64_t seen = 0;
    while (seen < chunk_->num_values) {
      const PageHeader header = ReadPageHeader(bytes);
      const std::string_view page = bytes.Take(static_cast<std::uint64_t>(header.compressed_size));
      if (header.type == kDictionaryPage) {
        ReadDictionary(header, page);
      } else if (header.type == kDataPage || header.type == kDataPageV2) {
        if (header.num_values > chunk_->num_values - seen) {
          throw Malformed("has pages of more values than the column");
        }
        ReadData(header, page);
        seen += header.num_values;
      }
    }
    if (leaf_->max_repetition > 0) {
      column_.offsets.push_back(static_cast<std::int64_t>(column_.values.size()));
      // The first row opened an additional row before it.
      column_.offsets.erase(column_.offsets.begin());
    }
    if (column_.num_rows() != num_rows_) {
      throw Malformed("has " + std::to_string(column_.num_rows()) + " rows; its row group has " +
                      std::to_string(num_rows_));
    }
    return std::move(column_);
  }

 private:
  void ReadDictionary(const PageHeader& header, std::string_view page) {
    const std::string plain = Decompress(chunk_->codec, page, header.uncompressed_size, budget_);
    if (!budget_.Take(static_cast<std::uint64_t>(header.num_values), sizeof(double))) {
      throw Malformed("declares a dictionary of " + std::to_string(header.num_values) +
                      " values, too many for a file of this size");
    }
    Bytes bytes(plain);
    dictionary_ = DecodePlain(*leaf_, bytes, header.num_values);
  }

  void ReadData(const PageHeader& header, std::string_view page) {
    std::string_view repetition;
    std::string_view definition;
    std::string plain;
    std::string_view values;
    if (header.type == kDataPageV2) {
      Bytes bytes(page);
      repetition = bytes.Take(static_cast<std::uint64_t>(header.repetition_bytes));
      definition = bytes.Take(static_cast<std::uint64_t>(header.definition_bytes));
      const std::int64_t levels = std::int64_t{header.repetition_bytes} + header.definition_bytes;
      const std::string_view rest = bytes.Take(bytes.left());
      plain = Decompress(header.is_compressed && !rest.empty() ? chunk_->codec : kUncompressed,
                         rest, header.uncompressed_size - levels, budget_);
      values = plain;
    } else {
      plain = Decompress(chunk_->codec, page, header.uncompressed_size, budget_);
      Bytes bytes(plain);
      if (leaf_->max_repetition > 0) repetition = bytes.Take(bytes.Fixed<std::uint32_t>());
      if (leaf_->max_definition > 0) definition = bytes.Take(bytes.Fixed<std::uint32_t>());
      values = bytes.Take(bytes.left());
    }
    ReadLevels(repetition, definition, header.num_values);
    const std::size_t first = column_.values.size();
    const auto slots = static_cast<std::int64_t>(present_.size());
    const std::int64_t count = std::count(present_.begin(), present_.end(), true);
    ReadValues(header.encoding, values, count);
    if (count == slots) return;
    // Stored values exclude missing ones: moves each value to its slot, from the last to the first.
    column_.values.resize(first + present_.size());
    std::size_t from = first + static_cast<std::size_t>(count);
    for (std::size_t slot = present_.size(); slot-- > 0;) {
      column_.values[first + slot] =
          present_[slot] ? column_.values[--from] : std::numeric_limits<double>::quiet_NaN();
    }
  }

  // Determines the first value of each row and which values are present.
  void ReadLevels(std::string_view repetition, std::string_view definition, int count) {
    RunLength repetitions(repetition, BitWidth(leaf_->max_repetition));
    RunLength definitions(definition, BitWidth(leaf_->max_definition));
    present_.clear();
    const auto first = static_cast<std::int64_t>(column_.values.size());
    for (int i = 0; i < count; ++i) {
      const bool continues = leaf_->max_repetition > 0 && repetitions.Next() > 0;
      const int level = leaf_->max_definition > 0 ? static_cast<int>(definitions.Next()) : 0;
      if (continues && column_.offsets.size() < 2) throw Malformed("begins in the middle of a row");
      // A list opens a row with its first entry; an empty list has none.
      if (leaf_->max_repetition > 0 && !continues) {
        column_.offsets.push_back(first + static_cast<std::int64_t>(present_.size()));
      }
      if (leaf_->max_repetition > 0 && level < leaf_->repeated_definition) continue;
      present_.push_back(level == leaf_->max_definition);
      if (leaf_->max_repetition == 0) {
        column_.offsets.push_back(first + static_cast<std::int64_t>(present_.size()));
      }
    }
  }

  void ReadValues(int encoding, std::string_view values, std::int64_t count) {
    Bytes bytes(values);
    if (encoding == kPlain) {
      const std::vector<double> plain = DecodePlain(*leaf_, bytes, count);
      column_.values.insert(column_.values.end(), plain.begin(), plain.end());
    } else if (encoding == kRle && leaf_->type == kBoolean) {
      RunLength truths(bytes.Take(bytes.Fixed<std::uint32_t>()), 1);
      for (std::int64_t i = 0; i < count; ++i) column_.values.push_back(truths.Next());
    } else if (encoding == kPlainDictionary || encoding == kRleDictionary) {
      if (count == 0) return;
      const int width = bytes.Byte();
      RunLength indices(bytes.Take(bytes.left()), width);
      for (std::int64_t i = 0; i < count; ++i) {
        const std::uint32_t index = indices.Next();
        if (index >= dictionary_.size()) throw Malformed("points past the end of its dictionary");
        column_.values.push_back(dictionary_[index]);
      }
    } else {
      throw Malformed("has the encoding " + EncodingName(encoding) +
                      "; PLAIN, dictionaries and RLE can be read: write it again with these, as "
                      "pyarrow does by default");
    }
  }

  const ParquetFile::Leaf* leaf_;
  const ParquetFile::Chunk* chunk_;
  std::int64_t num_rows_;
  core::ReadBudget budget_;
  std::vector<double> dictionary_;
  std::vector<bool> present_;  // for the current page
  ParquetColumn column_;
};

ParquetFile::ParquetFile(std::filesystem::path path)
    : path_(std::move(path)), in_(path_, std::ios::binary | std::ios::ate) {
  if (!in_) Fail("cannot be opened");
  size_ = static_cast<std::int64_t>(in_.tellg());
  ReadFooter();
}

void ParquetFile::Fail(const std::string& reason) const {
  throw std::runtime_error(path_.string() + ": " + reason);
}

std::string ParquetFile::ReadBytes(std::int64_t start, std::int64_t size) const {
  if (start < 0 || size < 0 || start > size_ || size > size_ - start) {
    Fail("points past its end");
  }
  std::string bytes(static_cast<std::size_t>(size), '\0');
  in_.clear();
  in_.seekg(start);
  in_.read(bytes.data(), size);
  if (in_.gcount() != size) Fail("cannot be read");
  return bytes;
}

void ParquetFile::ReadFooter() {
  constexpr std::int64_t kMagic = 4;
  constexpr std::int64_t kTail = 8;  // length of the metadata, and the trailing magic
  if (size_ < kMagic + kTail || ReadBytes(0, kMagic) != "PAR1") Fail("is not a Parquet file");
  const std::string tail = ReadBytes(size_ - kTail, kTail);
  if (tail.substr(4) != "PAR1") Fail("is truncated: it does not end as a Parquet file does");
  std::uint32_t length = 0;
  std::memcpy(&length, tail.data(), sizeof(length));
  if (length > size_ - kMagic - kTail) {
    Fail("declares metadata of " + std::to_string(length) + " bytes");
  }
  const std::string footer = ReadBytes(size_ - kTail - length, length);
  try {
    Bytes bytes(footer);
    FooterParser(*this, bytes).Parse();
  } catch (const Malformed& e) {
    Fail(e.what());
  }
}

ParquetColumn ParquetFile::Read(int row_group, const std::string& column) const {
  const RowGroup& group = row_groups_.at(static_cast<std::size_t>(row_group));
  const Leaf* found = nullptr;
  const Chunk* chunk = nullptr;
  for (std::size_t i = 0; i < leaves_.size(); ++i) {
    if (leaves_[i].column != column) continue;
    if (found != nullptr) Fail("column " + column + " has several parts, not numbers or one list");
    found = &leaves_[i];
    chunk = &group.chunks[i];
  }
  if (found == nullptr) Fail("has no column " + column);
  const std::string data = ReadBytes(chunk->start, chunk->size);
  try {
    return ChunkDecoder(*found, *chunk, group.num_rows, budget()).Decode(data);
  } catch (const Malformed& e) {
    Fail("column " + column + " " + e.what());
  }
}

}  // namespace dfr::imitation::internal
