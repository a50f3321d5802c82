#pragma once

#include <sys/types.h>

#include <optional>
#include <string>
#include <vector>

namespace dfr::test {

/// A child program of the test. It ends when the thread that created it ends, even if that thread
/// is killed.
class PeerProcess {
 public:
  /// Runs `command` (program and arguments) with CycloneDDS limited to the loopback interface.
  /// @throws std::runtime_error if it cannot be started.
  explicit PeerProcess(const std::vector<std::string>& command);
  ~PeerProcess();
  PeerProcess(const PeerProcess&) = delete;
  PeerProcess& operator=(const PeerProcess&) = delete;

  [[nodiscard]] pid_t pid() const noexcept { return pid_; }
  /// Sends a signal: SIGKILL, SIGSTOP, ...
  void Signal(int number) const;
  /// Returns the exit code, or -1 if it was killed; nothing while it runs.
  [[nodiscard]] std::optional<int> Ended();
  /// Waits for the end without a limit. Returns the exit code, or -1 if it was killed.
  [[nodiscard]] int Await();

 private:
  std::optional<int> Reap(int options);

  pid_t pid_ = -1;
  std::optional<int> code_;
};

}  // namespace dfr::test
