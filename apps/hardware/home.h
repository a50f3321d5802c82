#pragma once

#include <atomic>
#include <functional>
#include <string>

#include "clock.h"

namespace dfr::apps::hardware_app {

/// Options for RunHome().
struct HomeOptions {
  std::string platform;  ///< Serial port.
  /// Asks the operator. Returns true if the answer is `word`; otherwise nothing moves.
  std::function<bool(const std::string& question, const std::string& word)> confirms;
  /// Prints progress for the user.
  std::function<void(const std::string& text)> say;
  const std::atomic<bool>* interrupted = nullptr;  ///< Ends the wait when true; may be nullptr.
  Clock* clock = &MachineClock();                  ///< Borrowed.
};

/// Sends the Stewart platform home, for example if a killed program left it moving. Its pose is
/// unknown: only cutting its power stops it on the way.
/// @return the program's exit code: 1 if the operator did not confirm, or interrupted the program.
/// @throws core::Error naming the port, the failure and the remedy.
int RunHome(const HomeOptions& options);

}  // namespace dfr::apps::hardware_app
