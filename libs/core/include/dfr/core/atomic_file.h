#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace dfr::core {

/// A file that is written as a whole or not at all. The bytes go to a temporary file beside it,
/// which Commit() renames when they are on the disk: a full disk, a kill or an exception leaves
/// what was there before.
///
/// What is there is respected. A symbolic link stays one, and the file that it names is replaced. A
/// device, a pipe or what a process has open (/dev/stdout) is written to. The new file has mode
/// and, where the system permits, owner and group of the old one; a new one has what the umask
/// leaves of 0666. A file that may not be written is not replaced. Further names of the same file
/// (hard links) keep the old content.
///
/// All functions throw std::runtime_error naming the file and what the system said.
class AtomicFile {
 public:
  explicit AtomicFile(const std::filesystem::path& path);
  /// Without Commit() nothing has happened.
  ~AtomicFile();
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;

  void Write(std::string_view bytes);
  void Commit();

 private:
  [[noreturn]] void Fail(const char* what, int error);
  void Discard() noexcept;

  std::string name_;       // what the caller calls it, in messages
  std::string target_;     // behind symbolic links
  std::string temporary_;  // empty where target_ is written to
  int descriptor_ = -1;
};

/// Writes `bytes` as an AtomicFile.
void ReplaceFile(const std::filesystem::path& path, std::string_view bytes);

}  // namespace dfr::core
