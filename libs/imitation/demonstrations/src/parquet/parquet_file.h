#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/files/read_budget.h"

namespace dfr::imitation::internal {

/// Values of rows of a column, one row after another: row r is values [offsets[r], offsets[r + 1]).
/// A flat column has one value per row. Missing values are NaN.
struct ParquetColumn {
  std::vector<double> values;
  std::vector<std::int64_t> offsets = {0};

  [[nodiscard]] std::int64_t num_rows() const noexcept {
    return static_cast<std::int64_t>(offsets.size()) - 1;
  }
};

/// Reader of numbers (including half precision and unsigned ones) and Boolean values in an Apache
/// Parquet file: flat columns and columns of lists; pages of versions 1 and 2; plain, dictionary
/// and run-length encodings; uncompressed, Snappy, Zstandard.
///
/// Files are untrusted. No claimed size is allocated before it is checked against the available
/// data. The values of all row groups are limited to core::ReadBudget of the file's size, as are
/// the pages of each column of a row group. All functions throw std::runtime_error naming the file,
/// the column and the reason.
class ParquetFile {
 public:
  /// Storage of a column, or of the entries of a column's lists.
  struct Leaf {
    std::string column;  // name of the top-level column
    std::string path;    // "action.list.element"
    int type = 0;
    bool is_unsigned = false;
    bool is_half = false;  // two-byte float
    int max_definition = 0;
    int max_repetition = 0;
    int repeated_definition = 0;  // least definition level at which a row's list has an entry
  };

  /// Location of a leaf's values in a row group.
  struct Chunk {
    int codec = 0;
    std::int64_t num_values = 0;
    std::int64_t start = 0;
    std::int64_t size = 0;
  };

  explicit ParquetFile(std::filesystem::path path);

  [[nodiscard]] int num_row_groups() const noexcept { return static_cast<int>(row_groups_.size()); }
  [[nodiscard]] std::int64_t num_rows(int row_group) const {
    return row_groups_.at(static_cast<std::size_t>(row_group)).num_rows;
  }
  /// Names of the top-level columns, in the order of the schema.
  [[nodiscard]] const std::vector<std::string>& columns() const noexcept { return names_; }

  /// Reads all rows of a row group.
  [[nodiscard]] ParquetColumn Read(int row_group, const std::string& column) const;

 private:
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

  friend class FooterParser;

  std::filesystem::path path_;
  mutable std::ifstream in_;
  std::int64_t size_ = 0;
  std::vector<std::string> names_;
  std::vector<Leaf> leaves_;
  std::vector<RowGroup> row_groups_;
};

}  // namespace dfr::imitation::internal
