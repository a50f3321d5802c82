#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "dfr/experiment/ledger.h"

namespace dfr::experiment::internal {

/// A file descriptor that closes itself.
class Descriptor {
 public:
  explicit Descriptor(int descriptor = -1) noexcept : descriptor_(descriptor) {}
  ~Descriptor();
  Descriptor(Descriptor&& other) noexcept : descriptor_(std::exchange(other.descriptor_, -1)) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    std::swap(descriptor_, other.descriptor_);
    return *this;
  }
  [[nodiscard]] int get() const noexcept { return descriptor_; }

 private:
  int descriptor_;
};

/// Opens or creates a file for appending, with a lock that ends with the descriptor or the process.
/// Takes no lock on a file system that does not support locks.
/// @throws std::runtime_error naming the file if it cannot be written or another process holds it.
[[nodiscard]] Descriptor OpenLocked(const std::filesystem::path& path);

/// Returns true if a process holds OpenLocked()'s lock.
[[nodiscard]] bool IsLocked(const std::filesystem::path& path);

/// A ledger open for writing.
class LedgerWriter {
 public:
  /// Opens or creates the file; the first line is written with the first unit. Removes an
  /// incomplete last line, which a killed run leaves. With options.salvage, moves damaged lines to
  /// <path>.dropped. Reports both to options.notice, and finished units of a build that, like this
  /// one, does not know its commit.
  /// @throws std::runtime_error as Evaluate().
  LedgerWriter(const std::filesystem::path& path, const LedgerHeader& header,
               const EvaluationOptions& options);

  /// Returns the records found when the ledger was opened.
  [[nodiscard]] const std::vector<LedgerRecord>& finished() const noexcept { return finished_; }

  /// Appends a line and passes it to the system. After the call, the unit survives the end of this
  /// process. A power failure loses at most the lines of one second.
  /// @throws std::runtime_error naming the file and reason; the file then ends with the previous
  ///   unit.
  void Append(const LedgerRecord& record);

 private:
  void Write(const std::string& line);

  std::filesystem::path path_;
  std::string header_line_;
  std::uint64_t identity_;
  std::vector<LedgerRecord> finished_;
  Descriptor file_;
  std::size_t size_ = 0;
  std::int64_t last_sync_ = 0;
};

}  // namespace dfr::experiment::internal
