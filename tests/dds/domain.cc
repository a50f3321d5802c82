#include "tests/dds/domain.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <filesystem>
#include <stdexcept>
#include <string>

namespace dfr::test {
namespace {

int Claim() {
  // Domains above 101 use ports from Linux's ephemeral range.
  for (int domain = 20; domain <= 100; ++domain) {
    const auto file = std::filesystem::temp_directory_path() /
                      ("dfr-test-domain-" + std::to_string(domain) + ".lock");
    const int fd = ::open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    if (fd < 0) continue;
    // The lock lasts until the process ends or is killed.
    if (::flock(fd, LOCK_EX | LOCK_NB) == 0) return domain;
    ::close(fd);
  }
  throw std::runtime_error("no DDS domain is free for this test");
}

}  // namespace

int OwnDomain() {
  static const int kDomain = Claim();
  return kDomain;
}

}  // namespace dfr::test
