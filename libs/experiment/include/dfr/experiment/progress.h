#pragma once

#include <cstdint>
#include <functional>
#include <iosfwd>
#include <mutex>
#include <optional>
#include <string>

namespace dfr::experiment {

/// How far a long command has come.
struct Progress {
  std::int64_t done = 0;
  std::int64_t total = 0;
  double elapsed_s = 0.0;
  std::optional<double> remaining_s;  ///< Absent until there is something to go by.
  std::string label;                  ///< What is being done, or the latest figures.
};

using ProgressCallback = std::function<void(const Progress&)>;

/// Counts finished work from any number of threads and tells a callback, at most every
/// `interval_s` and at the end. The callback is called by one thread at a time.
class ProgressMeter {
 public:
  /// `already_done` of `total` were done by an earlier run: they count as done, but not for the
  /// estimate of the remaining time. `callback` may be empty.
  /// @param clock_s  seconds on a clock that never goes back; empty: std::chrono::steady_clock.
  ProgressMeter(std::int64_t total, ProgressCallback callback, std::int64_t already_done = 0,
                double interval_s = 0.1, std::function<double()> clock_s = {});

  /// `work` more is done. An empty label keeps the previous one.
  void Advance(std::int64_t work = 1, std::string label = {});

 private:
  std::mutex mutex_;
  ProgressCallback callback_;
  std::int64_t total_;
  std::int64_t done_;
  std::int64_t at_start_;
  std::string label_;
  double interval_s_;
  std::function<double()> clock_s_;
  double start_s_;
  std::optional<double> last_call_s_;
};

/// Shows progress on a stream: a bar that redraws itself on a terminal, otherwise a plain line now
/// and then. A ProgressCallback through std::ref or a lambda; belongs to one thread at a time.
class ProgressBar {
 public:
  /// On stderr, as a bar where that is a terminal.
  explicit ProgressBar(std::string title);
  /// On `stream`, which must outlive this. Without a bar, a line every `line_interval_s`.
  ProgressBar(std::string title, std::ostream& stream, bool is_terminal,
              double line_interval_s = 10.0);
  /// Ends an unfinished bar's line.
  ~ProgressBar();
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  void Show(const Progress& progress);

 private:
  std::string title_;
  std::ostream* stream_;
  bool is_terminal_;
  double line_interval_s_;
  std::optional<double> last_line_s_;
  bool line_is_open_ = false;
};

/// "7 s", "3:07 min", "2:03:07 h".
[[nodiscard]] std::string FormatDuration(double seconds);

}  // namespace dfr::experiment
