#include "dfr/core/files/atomic_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstddef>
#include <stdexcept>
#include <system_error>

namespace dfr::core {
namespace {

constexpr int kMostLinks = 40;  // the kernel's limit

// Resolves symbolic links, the last of which may point to a missing file. Beyond the kernel's
// limit, returns the path itself, which cannot be opened.
std::string Resolve(const std::filesystem::path& from) {
  std::filesystem::path path = from;
  for (int i = 0; i <= kMostLinks; ++i) {
    std::error_code error;
    if (!std::filesystem::is_symlink(path, error)) return path.string();
    // A link in /proc leads to an open file of a process (for example, /dev/stdout), regardless of
    // the file that its text names.
    if (path.string().starts_with("/proc/")) return path.string();
    const std::filesystem::path next = std::filesystem::read_symlink(path, error);
    if (error) return path.string();
    path = next.is_absolute() ? next : path.parent_path() / next;
  }
  return from.string();
}

}  // namespace

AtomicFile::AtomicFile(const std::filesystem::path& path, const std::string& ending)
    : name_(path.string()), target_(Resolve(path)) {
  struct stat old {};
  const bool exists = ::stat(target_.c_str(), &old) == 0;
  if (!exists && errno != ENOENT) Fail("cannot be written", errno);
  if (exists && S_ISDIR(old.st_mode)) Fail("cannot be written", EISDIR);
  if (exists && (!S_ISREG(old.st_mode) || target_.starts_with("/proc/"))) {
    descriptor_ = ::open(target_.c_str(), O_WRONLY | O_APPEND | O_CLOEXEC | O_NOCTTY);
    if (descriptor_ < 0) Fail("cannot be opened for writing", errno);
    return;
  }
  if (exists && ::access(target_.c_str(), W_OK) != 0) Fail("cannot be written", errno);

  static std::atomic<unsigned> count = 0;
  const std::filesystem::path folder = std::filesystem::path(target_).parent_path();
  do {
    const std::string part =
        ".dfr-" + std::to_string(::getpid()) + "-" + std::to_string(count++) + ending;
    temporary_ = (folder / part).string();
    descriptor_ = ::open(temporary_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  } while (descriptor_ < 0 && errno == EEXIST);
  if (descriptor_ < 0) {
    const int error = errno;
    temporary_.clear();
    Fail("cannot be created", error);
  }
  if (!exists) return;
  // If the group cannot be kept, the new group must not get any permission.
  const bool owned = ::fchown(descriptor_, old.st_uid, old.st_gid) == 0 ||
                     ::fchown(descriptor_, static_cast<uid_t>(-1), old.st_gid) == 0;
  const mode_t mode = old.st_mode & (owned ? 07777 : 0707);
  if (::fchmod(descriptor_, mode) != 0) Fail("cannot keep its mode", errno);
}

AtomicFile::~AtomicFile() { Discard(); }

void AtomicFile::Discard() noexcept {
  if (descriptor_ >= 0) ::close(descriptor_);
  descriptor_ = -1;
  if (!temporary_.empty()) ::unlink(temporary_.c_str());
  temporary_.clear();
}

void AtomicFile::Fail(const char* what, int error) {
  Discard();
  throw std::runtime_error(name_ + ": " + what + ": " + std::generic_category().message(error));
}

void AtomicFile::Write(std::string_view bytes) {
  while (!bytes.empty()) {
    const ::ssize_t written = ::write(descriptor_, bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) Fail("cannot be written", errno);
    bytes.remove_prefix(static_cast<std::size_t>(written));
  }
}

void AtomicFile::Commit() {
  // Without fsync, the rename may reach the disk before the bytes do.
  if (!temporary_.empty() && ::fsync(descriptor_) != 0) Fail("cannot be written", errno);
  const int closed = ::close(descriptor_);
  descriptor_ = -1;
  if (closed != 0) Fail("cannot be written", errno);
  if (temporary_.empty()) return;
  if (::rename(temporary_.c_str(), target_.c_str()) != 0) Fail("cannot be replaced", errno);
  temporary_.clear();
}

void ReplaceFile(const std::filesystem::path& path, std::string_view bytes) {
  AtomicFile file(path);
  file.Write(bytes);
  file.Commit();
}

}  // namespace dfr::core
