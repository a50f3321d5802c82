#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace dfr::core {

/// A file that is written completely or not at all. The bytes go to a temporary file in the same
/// folder. Commit() renames it once the bytes are on the disk. A full disk, a kill or an exception
/// leaves the previous file intact.
///
/// Existing targets: a symbolic link remains a link, and the file it points to is replaced. A
/// device, a pipe or a file that a process has open (/dev/stdout) is written in place. The new file
/// keeps the old file's mode and, if the system permits, its owner and group. Without an old file,
/// the mode is 0666 without the bits of the umask. A file without write permission is not replaced.
/// Other hard links to the file keep the old content.
///
/// All functions throw std::runtime_error naming the file and the system's message.
class AtomicFile {
 public:
  /// @param ending  ending of the temporary file's name; some libraries choose a format by it.
  explicit AtomicFile(const std::filesystem::path& path, const std::string& ending = ".part");
  /// Discards the data unless Commit() was called.
  ~AtomicFile();
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;

  void Write(std::string_view bytes);
  /// Returns the path for writing by other means than Write(). Call before Commit().
  [[nodiscard]] const std::string& written() const noexcept {
    return temporary_.empty() ? target_ : temporary_;
  }
  void Commit();

 private:
  [[noreturn]] void Fail(const char* what, int error);
  void Discard() noexcept;

  std::string name_;       // name of the file in messages, as given by the caller
  std::string target_;     // path after resolving symbolic links
  std::string temporary_;  // empty if target_ is written in place
  int descriptor_ = -1;
};

/// Writes `bytes` as an AtomicFile.
void ReplaceFile(const std::filesystem::path& path, std::string_view bytes);

}  // namespace dfr::core
