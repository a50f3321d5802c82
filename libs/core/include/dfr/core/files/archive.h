#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/files/read_budget.h"
#include "dfr/core/matrix.h"

namespace dfr::core {

/// Writes one of this project's files (a policy, a support, a checkpoint). The file holds a header
/// with kind and version, tagged values in the order of the calls, and a checksum. Little-endian;
/// doubles keep all bits.
class ArchiveWriter {
 public:
  /// `kind` names the content, for example "mlp-policy". `version` increases whenever the sequence
  /// of values changes.
  ArchiveWriter(std::string_view kind, int version);

  void Integer(std::int64_t value);
  void Number(double value);
  void Text(std::string_view value);
  void Numbers(std::span<const double> values);
  void Integers(std::span<const int> values);
  void MatrixBlock(const Matrix& values);

  /// Writes the file as an AtomicFile: a full disk or a kill leaves the previous file intact.
  /// @throws std::runtime_error naming the file and the system's message.
  void Save(const std::filesystem::path& path) const;

 private:
  std::string bytes_;
};

/// Reads files of ArchiveWriter. The constructor checks the whole file before any value is
/// returned. Every call throws std::runtime_error naming the file and the reason if the file is
/// missing, truncated, damaged, of another kind or version, or if its next value is not of the
/// requested type.
class ArchiveReader {
 public:
  /// @param version  the only version that the caller reads.
  ArchiveReader(const std::filesystem::path& path, std::string_view kind, int version);

  [[nodiscard]] const std::string& file() const noexcept { return file_; }

  std::int64_t Integer();
  /// Returns Integer(), which must lie in [low, high].
  int IntegerIn(int low, int high);
  double Number();
  std::string Text();
  std::vector<double> Numbers();
  std::vector<int> Integers();
  Matrix MatrixBlock();
  /// Checks that no value is left.
  void End();

  /// Call before creating `count` objects of `bytes_each` bytes each, if `count` comes from the
  /// file. Fails if the file is too small for that amount of memory. `what` names the objects in
  /// the message.
  void Spend(std::uint64_t count, std::uint64_t bytes_each, const char* what);

  /// Throws std::runtime_error naming the file and `reason`, for a value that is invalid.
  [[noreturn]] void Fail(const std::string& reason) const;

 private:
  std::string_view Take(std::size_t size);
  void Expect(char tag);
  std::uint64_t Size(std::size_t bytes_per_entry);

  std::string file_;
  std::string bytes_;
  std::size_t position_ = 0;
  ReadBudget budget_{0};
};

}  // namespace dfr::core
