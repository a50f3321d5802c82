#include "dfr/runtime/async_printer.h"

#include <poll.h>
#include <unistd.h>

#include <chrono>
#include <cstdarg>
#include <cstdio>
#include <cstring>

#include "dfr/core/text/format.h"
#include "dfr/runtime/periodic_timer.h"

namespace dfr::runtime {

AsyncPrinter::AsyncPrinter(int file, int patience_ms)
    : file_(file), patience_ms_(patience_ms), thread_([this] { Run(); }) {}

AsyncPrinter::~AsyncPrinter() {
  end_ = true;
  thread_.join();
}

void AsyncPrinter::Say(const char* format, ...) noexcept {
  ++said_;
  Text text{};
  std::va_list arguments;
  va_start(arguments, format);
  static_cast<void>(std::vsnprintf(text.data(), text.size(), format, arguments));
  va_end(arguments);
  core::MakePrintable({text.data(), std::strlen(text.data())}, /*keeps_lines=*/true);
  if (!queue_.Put(text)) lost_.fetch_add(1);
}

bool AsyncPrinter::Print(const char* text) noexcept {
  const char* const end = text + std::strlen(text);
  while (text != end) {
    // write() would wait for a stopped terminal.
    pollfd output{file_, POLLOUT, 0};
    if (::poll(&output, 1, end_ ? patience_ms_ : 100) <= 0) {
      if (end_) return false;
      continue;
    }
    const ssize_t size = ::write(file_, text, static_cast<std::size_t>(end - text));
    if (size <= 0) return true;  // no program reads the output: drops the text
    text += size;
  }
  return true;
}

void AsyncPrinter::Run() noexcept {
  GiveUpRealTime();
  Text text;
  while (true) {
    const bool last = end_;
    while (queue_.Take(text)) {
      if (!Print(text.data())) return;
    }
    if (const std::int64_t lost = lost_.exchange(0); lost > 0) {
      std::snprintf(text.data(), text.size(), "  (%lld lines were not shown)\n",
                    static_cast<long long>(lost));
      if (!Print(text.data())) return;
    }
    if (last) return;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
}

}  // namespace dfr::runtime
