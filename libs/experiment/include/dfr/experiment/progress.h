#pragma once

#include <cstdint>
#include <functional>
#include <iosfwd>
#include <mutex>
#include <optional>
#include <string>

namespace dfr::experiment {

/// Progress of a long command.
struct Progress {
  std::int64_t done = 0;
  std::int64_t total = 0;
  double elapsed_s = 0.0;
  std::optional<double> remaining_s;  ///< Absent until it can be estimated.
  std::string label;                  ///< Current work, or the latest results.
};

using ProgressCallback = std::function<void(const Progress&)>;

/// Counts completed work from any number of threads and reports it to a callback at most every
/// `interval_s` and at the end. Calls to the callback never overlap.
class ProgressMeter {
 public:
  /// `already_done` of `total` were completed by an earlier run. They count as done but do not
  /// affect the estimate of the remaining time. `callback` may be empty.
  /// @param clock_s  seconds of a monotonic clock; empty: std::chrono::steady_clock.
  ProgressMeter(std::int64_t total, ProgressCallback callback, std::int64_t already_done = 0,
                double interval_s = 0.1, std::function<double()> clock_s = {});

  /// Adds `work` to the completed work. An empty label keeps the previous label.
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

/// Shows progress on a stream: a redrawn bar on a terminal, otherwise occasional plain lines. Call
/// Show() in a ProgressCallback. Belongs to one thread at a time.
class ProgressBar {
 public:
  /// Writes to stderr, as a bar if it is a terminal.
  explicit ProgressBar(std::string title);
  /// Writes to `stream`, which must outlive this object. Without a bar, writes a line every
  /// `line_interval_s`.
  ProgressBar(std::string title, std::ostream& stream, bool is_terminal,
              double line_interval_s = 10.0);
  /// Ends the line of an unfinished bar.
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

/// Returns "7 s", "3:07 min", "2:03:07 h".
[[nodiscard]] std::string FormatDuration(double seconds);

}  // namespace dfr::experiment
