#include "tests/hardware_stewart/sprk_emulator.h"

#include <fcntl.h>
#include <poll.h>
#include <stdlib.h>
#include <unistd.h>

#include <array>
#include <stdexcept>

#include "tests/support/eventually.h"

namespace dfr::test {

SprkEmulator::SprkEmulator() : master_(::posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC)) {
  std::array<char, 128> name{};
  if (master_ < 0 || ::grantpt(master_) != 0 || ::unlockpt(master_) != 0 ||
      ::ptsname_r(master_, name.data(), name.size()) != 0 || ::pipe2(stop_, O_CLOEXEC) != 0) {
    throw std::runtime_error("no pseudo-terminal");
  }
  device_ = name.data();
  thread_ = std::thread([this] { Run(); });
}

SprkEmulator::~SprkEmulator() {
  if (thread_.joinable()) Unplug();
  ::close(stop_[0]);
  ::close(stop_[1]);
}

void SprkEmulator::Print(std::string_view text) const {
  pollfd room{master_, POLLOUT, 0};
  // Unread output fills the port's buffer, and further output is lost.
  if (::poll(&room, 1, 0) > 0) static_cast<void>(!::write(master_, text.data(), text.size()));
}

void SprkEmulator::Unplug() {
  const char byte = 0;
  if (::write(stop_[1], &byte, 1) != 1) std::terminate();
  thread_.join();
  ::close(master_);
}

void SprkEmulator::Run() {
  std::array<char, 4096> bytes{};
  for (;;) {
    std::array<pollfd, 2> ready = {{{master_, POLLIN, 0}, {stop_[0], POLLIN, 0}}};
    ::poll(ready.data(), ready.size(), -1);
    if (ready[1].revents != 0) return;
    if ((ready[0].revents & POLLIN) == 0 || hangs_) {
      // The port is not open, or its program must still read output: poll() returns at once.
      ::poll(&ready[1], 1, 2);
      continue;
    }
    const ssize_t count = ::read(master_, bytes.data(), bytes.size());
    if (count <= 0) continue;
    const std::lock_guard lock(mutex_);
    firmware_.Receive({bytes.data(), static_cast<std::size_t>(count)});
  }
}

std::vector<SprkFirmware::Command> SprkEmulator::Await(std::size_t count) {
  std::vector<SprkFirmware::Command> commands;
  Eventually([&] {
    const std::lock_guard lock(mutex_);
    commands = firmware_.commands();
    return commands.size() >= count;
  });
  return commands;
}

}  // namespace dfr::test
