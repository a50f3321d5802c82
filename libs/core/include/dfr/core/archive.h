#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/read_budget.h"

namespace dfr::core {

/// Writes one of this project's own files (a policy, a support, a checkpoint): a header with the
/// kind of file and its version, tagged values in the order they are appended, and a checksum.
/// Little-endian; doubles keep all bits.
class ArchiveWriter {
 public:
  /// `kind` names what is inside, "mlp-policy" say; `version` counts up when its values change.
  ArchiveWriter(std::string_view kind, int version);

  void Integer(std::int64_t value);
  void Number(double value);
  void Text(std::string_view value);
  void Numbers(std::span<const double> values);
  void Integers(std::span<const int> values);
  void MatrixBlock(const Matrix& values);

  /// Writes the file as an AtomicFile: a full disk or a kill leaves the previous file as it was.
  /// @throws std::runtime_error naming the file and what the system said.
  void Save(const std::filesystem::path& path) const;

 private:
  std::string bytes_;
};

/// Reads what ArchiveWriter wrote. The whole file is checked before the first value is returned;
/// every call throws std::runtime_error naming the file and the reason where the file is missing,
/// truncated, damaged, of another kind or version, or holds another value than asked.
class ArchiveReader {
 public:
  /// @param version  the one version that the caller understands.
  ArchiveReader(const std::filesystem::path& path, std::string_view kind, int version);

  [[nodiscard]] const std::string& file() const noexcept { return file_; }

  std::int64_t Integer();
  /// Integer(), which must lie in [low, high].
  int IntegerIn(int low, int high);
  double Number();
  std::string Text();
  std::vector<double> Numbers();
  std::vector<int> Integers();
  Matrix MatrixBlock();
  /// Checks that nothing is left.
  void End();

  /// For callers that are about to make `count` things of `bytes_each` each because the file says
  /// so: fails where the file is too small to ask for that much. `what` names them in the message.
  void Spend(std::uint64_t count, std::uint64_t bytes_each, const char* what);

  /// For callers that find a value wrong: throws the same kind of error, naming the file.
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
