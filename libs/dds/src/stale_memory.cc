#include "stale_memory.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <exception>
#include <string>
#include <string_view>
#include <system_error>

namespace dfr::dds::internal {
namespace {

// A live process looks dead between creating a lock file and locking it.
constexpr std::time_t kGraceSeconds = 10;

// Returns true if no process holds the lock or could be about to take it.
bool Abandoned(const std::filesystem::path& lock, std::time_t now) {
  const int fd = ::open(lock.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) return false;
  struct stat status {};
  const bool abandoned = ::fstat(fd, &status) == 0 && status.st_mtime + kGraceSeconds < now &&
                         ::flock(fd, LOCK_EX | LOCK_NB) == 0;
  ::close(fd);
  return abandoned;
}

}  // namespace

void RemoveStaleSegments(const std::filesystem::path& folder, std::time_t now) noexcept {
  constexpr std::string_view kPrefix = "fastrtps_";
  constexpr std::string_view kSuffix = "_el";
  constexpr std::size_t kId = 16;  // hexadecimal digits
  try {
    std::error_code error;
    for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
      const std::string name = entry.path().filename().string();
      // Skips ports, which processes share. Their names have a different format.
      if (name.size() != kPrefix.size() + kId + kSuffix.size() || !name.starts_with(kPrefix) ||
          !name.ends_with(kSuffix) ||
          name.find_first_not_of("0123456789abcdef", kPrefix.size()) != kPrefix.size() + kId ||
          !Abandoned(entry.path(), now)) {
        continue;
      }
      std::filesystem::remove(folder / name.substr(0, name.size() - kSuffix.size()), error);
      std::filesystem::remove(entry.path(), error);
    }
  } catch (const std::exception&) {
    return;
  }
}

}  // namespace dfr::dds::internal
