#include "parquet/parquet_pages.h"

#include <snappy.h>
#include <zstd.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "parquet/parquet_format.h"

namespace dfr::imitation::internal {
namespace {

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

// Converts an IEEE 754 binary16 number.
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

// Decodes `count` consecutive values of the encoding PLAIN. Reads no levels.
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
    Bytes bytes(data);
    std::int64_t seen = 0;
    while (seen < chunk_->num_values) {
      const PageHeader header = ReadPageHeader(bytes);
      const std::string_view page = bytes.Take(static_cast<std::uint64_t>(header.compressed_size));
      if (header.type == kDictionaryPage) {
        ReadDictionary(header, page);
      } else if (header.type == kDataPage || header.type == kDataPageV2) {
        if (header.num_values > chunk_->num_values - seen) {
          throw Malformed("has pages with more values than the column");
        }
        ReadData(header, page);
        seen += header.num_values;
      }
    }
    if (leaf_->max_repetition > 0) {
      column_.offsets.push_back(static_cast<std::int64_t>(column_.values.size()));
      // Removes the initial offset 0, which precedes the first row's offset.
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
      // The first entry of a list opens a row. An empty list has levels but no value.
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

}  // namespace

ParquetColumn DecodeChunk(const ParquetFile::Leaf& leaf, const ParquetFile::Chunk& chunk,
                          std::int64_t num_rows, const core::ReadBudget& budget,
                          std::string_view data) {
  return ChunkDecoder(leaf, chunk, num_rows, budget).Decode(data);
}

}  // namespace dfr::imitation::internal
