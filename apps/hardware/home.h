#pragma once

#include <atomic>
#include <functional>
#include <string>

#include "clock.h"

namespace dfr::apps::hardware_app {

/// Options for RunHome().
struct HomeOptions {
  std::string platform;  ///< Serial port.
  /// Whether the operator has typed `word` to a question; nothing moves where not.
  std::function<bool(const std::string& question, const std::string& word)> confirms;
  /// Tells the user what goes on.
  std::function<void(const std::string& text)> say;
  const std::atomic<bool>* interrupted = nullptr;  ///< Stops it on the way. nullptr: nothing does.
  Clock* clock = &MachineClock();                  ///< Borrowed.
};

/// Sends the Stewart platform home, where its power was left on in the middle of a wave, say.
/// @return the program's exit code: 1 if it was not asked for, or was stopped on the way.
/// @throws core::Error naming the port, what failed and the remedy.
int RunHome(const HomeOptions& options);

}  // namespace dfr::apps::hardware_app
