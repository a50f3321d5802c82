#include "dfr/runtime/keyboard.h"

#include <poll.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cmath>
#include <string_view>

namespace dfr::runtime {
namespace {

constexpr std::size_t kLongest = 4096;
// Limit on input discarded before a question, bytes. Typed input is shorter.
constexpr std::size_t kMostDiscarded = 1 << 20;

bool HasInput(int file, double timeout_s) noexcept {
  pollfd input{file, POLLIN, 0};
  return ::poll(&input, 1, static_cast<int>(std::ceil(1e3 * timeout_s))) > 0;
}

}  // namespace

void Keyboard::Discard() noexcept {
  text_.clear();
  ::tcflush(file_, TCIFLUSH);  // complete and partial lines; no effect on a pipe
  std::array<char, 4096> dropped;
  std::size_t total = 0;
  while (!ended_ && HasInput(file_, 0.0)) {
    const ssize_t size = ::read(file_, dropped.data(), dropped.size());
    if (size > 0) total += static_cast<std::size_t>(size);
    ended_ = size == 0 || (size < 0 && errno != EINTR && errno != EAGAIN) || total > kMostDiscarded;
  }
}

std::optional<std::string> Keyboard::Line(double timeout_s) {
  if (std::optional<std::string> line = Cut()) return line;
  Read(timeout_s);
  return Cut();
}

void Keyboard::Read(double timeout_s) {
  if (ended_ || !HasInput(file_, timeout_s)) return;
  std::array<char, 256> buffer;
  const ssize_t size = ::read(file_, buffer.data(), buffer.size());
  if (size > 0) {
    for (const char letter : std::string_view(buffer.data(), static_cast<std::size_t>(size))) {
      if (letter == '\n' || text_.size() - LineBegin() < kLongest) text_ += letter;
    }
  } else {
    ended_ = size == 0 || (errno != EINTR && errno != EAGAIN);
  }
}

std::size_t Keyboard::LineBegin() const noexcept { return text_.rfind('\n') + 1; }  // npos + 1 is 0

std::optional<std::string> Keyboard::Cut() {
  const std::size_t end = text_.find('\n');
  if (end == std::string::npos) return std::nullopt;
  std::string line = text_.substr(0, end);
  text_.erase(0, end + 1);
  return line;
}

}  // namespace dfr::runtime
