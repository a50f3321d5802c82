#include "parquet/parquet_file.h"

#include <algorithm>
#include <cstring>
#include <stdexcept>
#include <utility>

#include "dfr/core/files/read_file.h"
#include "parquet/parquet_format.h"
#include "parquet/parquet_pages.h"

namespace dfr::imitation::internal {

// Reads the metadata at the end of a file.
class FooterParser {
 public:
  FooterParser(ParquetFile& file, Bytes& bytes)
      : file_(&file), thrift_(bytes), budget_(file.budget()), values_(file.budget()) {}

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

  // The elements of the tree are in depth-first order, starting with the root.
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
    // Every leaf repeats the names of its parents.
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
      throw Malformed("has a row group whose columns differ from the file's schema");
    }
    if (group.num_rows < 0) throw Malformed("declares a negative number of rows");
    // A run of equal values takes a few bytes for any length, and row groups may share bytes.
    for (const ParquetFile::Chunk& chunk : group.chunks) {
      const std::int64_t most = std::max(chunk.num_values, group.num_rows);
      if (chunk.num_values < 0 ||
          !values_.Take(static_cast<std::uint64_t>(most), sizeof(double) + sizeof(std::int64_t))) {
        throw Malformed("declares " + std::to_string(most) +
                        " more values, too many for a file of this size");
      }
    }
    file_->row_groups_.push_back(std::move(group));
  }

  ParquetFile::Chunk ReadChunk() {
    ParquetFile::Chunk chunk;
    thrift_.Struct([&](std::int64_t field, Thrift::Kind kind) {
      if (field == 1) throw Malformed("has its columns in other files");
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
  core::ReadBudget values_;  // shared by all row groups
};

ParquetFile::ParquetFile(std::filesystem::path path)
    : path_((core::CheckPlainFile(path), std::move(path))),
      in_(path_, std::ios::binary | std::ios::ate) {
  if (!in_) Fail("cannot be opened");
  size_ = static_cast<std::int64_t>(in_.tellg());
  ReadFooter();
}

void ParquetFile::Fail(const std::string& reason) const {
  throw std::runtime_error(path_.string() + ": " + reason);
}

std::string ParquetFile::ReadBytes(std::int64_t start, std::int64_t size) const {
  if (start < 0 || size < 0 || start > size_ || size > size_ - start) {
    Fail("refers to bytes beyond its end");
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
  if (tail.substr(4) != "PAR1") Fail("is truncated: it does not end like a Parquet file");
  std::uint32_t length = 0;
  std::memcpy(&length, tail.data(), sizeof(length));
  if (length > size_ - kMagic - kTail) {
    Fail("declares metadata of " + std::to_string(length) + " bytes, more than it contains");
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
    if (found != nullptr)
      Fail("column " + column + " has several parts instead of numbers or one list");
    found = &leaves_[i];
    chunk = &group.chunks[i];
  }
  if (found == nullptr) Fail("has no column " + column);
  const std::string data = ReadBytes(chunk->start, chunk->size);
  try {
    return DecodeChunk(*found, *chunk, group.num_rows, budget(), data);
  } catch (const Malformed& e) {
    Fail("column " + column + " " + e.what());
  }
}

}  // namespace dfr::imitation::internal
