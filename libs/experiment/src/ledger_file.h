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

/// Opens or makes a file to append to, with a lock that ends with the descriptor or the process. A
/// file system without locks is used without.
/// @throws std::runtime_error naming the file that cannot be written, or that another process
/// holds.
[[nodiscard]] Descriptor OpenLocked(const std::filesystem::path& path);

/// Whether a process holds OpenLocked()'s lock.
[[nodiscard]] bool IsLocked(const std::filesystem::path& path);

/// A ledger to write to.
class LedgerWriter {
 public:
  /// Opens or begins the file; its first line is written with the first unit. A last line without
  /// its end, which a killed run leaves, is cut off; with options.salvage damaged lines are moved
  /// to <path>.dropped. options.notice is told of both.
  /// @throws std::runtime_error as Evaluate() says.
  LedgerWriter(const std::filesystem::path& path, const LedgerHeader& header,
               const EvaluationOptions& options);

  /// What was there when it was opened.
  [[nodiscard]] const std::vector<LedgerRecord>& finished() const noexcept { return finished_; }

  /// Appends a line and hands it to the system; at most a second of lines is not on the disk. When
  /// it returns, the unit survives the death of this process.
  /// @throws std::runtime_error naming file and reason; the file then ends with the unit before.
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
