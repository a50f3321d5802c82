#pragma once

#include <atomic>
#include <cstddef>
#include <mutex>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "tests/hardware_stewart/sprk_firmware.h"

namespace dfr::test {

/// A SprkFirmware behind a pseudo-terminal, on a separate thread.
class SprkEmulator {
 public:
  /// @throws std::runtime_error if there is no pseudo-terminal.
  SprkEmulator();
  ~SprkEmulator();
  SprkEmulator(const SprkEmulator&) = delete;
  SprkEmulator& operator=(const SprkEmulator&) = delete;

  /// The port that a driver opens.
  [[nodiscard]] const std::string& device() const noexcept { return device_; }
  /// Returns the received commands, once there are `count`.
  [[nodiscard]] std::vector<SprkFirmware::Command> Await(std::size_t count);
  /// Sends `text` to the program that has the port open. The firmware sends nothing by itself.
  void Print(std::string_view text) const;
  /// If true, the platform hangs and reads nothing.
  void Hang(bool hangs) { hangs_ = hangs; }
  /// Pulls the plug.
  void Unplug();

 private:
  void Run();

  int master_ = -1;
  int stop_[2] = {-1, -1};
  std::atomic<bool> hangs_ = false;
  std::string device_;
  std::mutex mutex_;
  SprkFirmware firmware_;
  std::thread thread_;
};

}  // namespace dfr::test
