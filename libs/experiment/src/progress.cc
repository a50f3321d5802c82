#include "dfr/experiment/progress.h"

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <iostream>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/text/format.h"

namespace dfr::experiment {
namespace {

double SteadySeconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace

ProgressMeter::ProgressMeter(std::int64_t total, ProgressCallback callback,
                             std::int64_t already_done, double interval_s,
                             std::function<double()> clock_s)
    : callback_(std::move(callback)),
      total_(total),
      done_(already_done),
      at_start_(already_done),
      interval_s_(interval_s),
      clock_s_(clock_s ? std::move(clock_s) : SteadySeconds),
      start_s_(clock_s_()) {
  DFR_THROW_UNLESS(0 <= already_done && already_done <= total,
                   already_done << " of " << total << " cannot be done already");
}

void ProgressMeter::Advance(std::int64_t work, std::string label) {
  const std::lock_guard lock(mutex_);
  done_ += work;
  if (!label.empty()) label_ = std::move(label);
  if (!callback_) return;
  const double now_s = clock_s_();
  if (done_ < total_ && last_call_s_ && now_s - *last_call_s_ < interval_s_) return;
  last_call_s_ = now_s;
  Progress progress{done_, total_, now_s - start_s_, std::nullopt, label_};
  if (done_ > at_start_) {
    progress.remaining_s = progress.elapsed_s * static_cast<double>(total_ - done_) /
                           static_cast<double>(done_ - at_start_);
  }
  callback_(progress);
}

ProgressBar::ProgressBar(std::string title)
    : ProgressBar(std::move(title), std::cerr, isatty(STDERR_FILENO) != 0) {}

ProgressBar::ProgressBar(std::string title, std::ostream& stream, bool is_terminal,
                         double line_interval_s)
    : title_(std::move(title)),
      stream_(&stream),
      is_terminal_(is_terminal),
      line_interval_s_(line_interval_s) {}

ProgressBar::~ProgressBar() {
  if (line_is_open_) *stream_ << std::endl;
}

void ProgressBar::Show(const Progress& progress) {
  const bool finished = progress.done >= progress.total;
  if (!is_terminal_) {
    const bool due = !last_line_s_ || progress.elapsed_s - *last_line_s_ >= line_interval_s_;
    if (!due && !finished) return;
    last_line_s_ = progress.elapsed_s;
  }
  const double share =
      progress.total > 0 ? static_cast<double>(progress.done) / static_cast<double>(progress.total)
                         : 1.0;
  std::string line = title_ + " ";
  if (is_terminal_) {
    constexpr int kWidth = 24;
    const int filled = std::clamp(static_cast<int>(share * kWidth), 0, kWidth);
    for (int i = 0; i < kWidth; ++i) line += i < filled ? "\u2588" : "\u2591";
    line += " ";
  }
  line += core::Format("%3d %%  ", static_cast<int>(100.0 * share)) +
          std::to_string(progress.done) + "/" + std::to_string(progress.total);
  if (finished) {
    line += "  done in " + FormatDuration(progress.elapsed_s);
  } else if (progress.remaining_s) {
    line += "  " + FormatDuration(*progress.remaining_s) + " left";
  }
  if (!progress.label.empty()) line += "  " + progress.label;
  if (!is_terminal_) {
    *stream_ << line << std::endl;
    return;
  }
  // Clears the rest of a longer previous line, and truncates a line wider than the terminal
  // (auto-wrap off): a wrapped line could not be overwritten.
  *stream_ << "\r\033[K\033[?7l" << line << "\033[?7h" << std::flush;
  line_is_open_ = !finished;
  if (finished) *stream_ << std::endl;
}

std::string FormatDuration(double seconds) {
  if (!(seconds >= 0.0)) return "?";
  const auto total = static_cast<long>(std::lround(std::min(seconds, 3.6e9)));
  if (total < 60) return core::Format("%ld s", total);
  if (total < 3600) return core::Format("%ld:%02ld min", total / 60, total % 60);
  return core::Format("%ld:%02ld:%02ld h", total / 3600, total / 60 % 60, total % 60);
}

}  // namespace dfr::experiment
