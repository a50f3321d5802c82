#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/read_budget.h"

namespace dfr::imitation::internal {

/// Values of rows of a column, one row after another: row r is values [offsets[r], offsets[r + 1]).
/// A flat column has one value per row. A missing value is NaN.
struct ParquetColumn {
  std::vector<double> values;
  std::vector<std::int64_t> offsets = {0};

  [[nodiscard]] std::int64_t num_rows() const noexcept {
    return static_cast<std::int64_t>(offsets.size()) - 1;
  }
};

/// Reads numbers (half precision and unsigned ones included) and truth values from an Apache
/// Parquet file: flat columns and lists of them; pages of version 1 and 2; plain, dictionary and
/// run-length encodings; uncompressed, Snappy, Zstandard.
///
/// A file is not trusted: no size that it claims is allocated before what it must fit into is
/// known, and what is beyond core::ReadBudget of the file's size, for each column of a row group
/// that is read, is refused. All functions throw std::runtime_error naming the file, the column and
/// the reason.
class ParquetFile {
 public:
  /// How a column, or the entries of its lists, is stored.
  struct Leaf {
    std::string column;  // at the top
    std::string path;    // "action.list.element"
    int type = 0;
    bool is_unsigned = false;
    bool is_half = false;  // a float of two bytes
    int max_definition = 0;
    int max_repetition = 0;
    int repeated_definition = 0;  // the level from which on a row's list has an entry
  };

  explicit ParquetFile(std::filesystem::path path);

  [[nodiscard]] int num_row_groups() const noexcept { return static_cast<int>(row_groups_.size()); }
  [[nodiscard]] std::int64_t num_rows(int row_group) const {
    return row_groups_.at(static_cast<std::size_t>(row_group)).num_rows;
  }
  /// Names of the columns at the file's top, in the order of the schema.
  [[nodiscard]] const std::vector<std::string>& columns() const noexcept { return names_; }

  /// All rows of a row group.
  [[nodiscard]] ParquetColumn Read(int row_group, const std::string& column) const;

 private:
  struct Chunk {
    int codec = 0;
    std::int64_t num_values = 0;
    std::int64_t start = 0;
    std::int64_t size = 0;
  };
  struct RowGroup {
    std::int64_t num_rows = 0;
    std::vector<Chunk> chunks;  // one per leaf
  };

  void ReadFooter();
  [[nodiscard]] core::ReadBudget budget() const {
    return core::ReadBudget(static_cast<std::uint64_t>(size_));
  }
  [[nodiscard]] std::string ReadBytes(std::int64_t start, std::int64_t size) const;
  [[noreturn]] void Fail(const std::string& reason) const;

  friend class ChunkDecoder;
  friend class FooterParser;

  std::filesystem::path path_;
  mutable std::ifstream in_;
  std::int64_t size_ = 0;
  std::vector<std::string> names_;
  std::vector<Leaf> leaves_;
  std::vector<RowGroup> row_groups_;
};

}  // namespace dfr::imitation::internal
