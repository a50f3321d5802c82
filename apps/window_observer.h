#pragma once

#include <functional>
#include <span>
#include <string>
#include <utility>

#include "dfr/control/rollout.h"
#include "dfr/core/text/format.h"

namespace dfr::apps {

/// Shows every control of a rollout in a window, and speeds up the many small controls of
/// recoveries.
class WindowObserver final : public control::RolloutObserver {
 public:
  /// Shows the plant's present state with `text` for `seconds`. Returns false if the window was
  /// closed.
  using Show = std::function<bool(const std::string& text, double seconds)>;

  explicit WindowObserver(Show show) : show_(std::move(show)) {}

  void OnStart(std::span<const double> /*x*/) override { Next("start", 0.7); }
  void OnControl(const control::RolloutEvent& event) override {
    const bool policy = event.step.mode == control::Mode::kPolicy;
    Next(core::Format("t = %d  %s  g = %.4f", event.step.t, control::Name(event.step.mode),
                      event.step.g),
         policy ? 0.12 : 0.016);
  }
  void OnEnd(const control::RolloutResult& result) override {
    const bool halted = result.outcome == core::Outcome::kHalted;
    Next(std::string(core::Name(result.outcome)) +
             (halted ? std::string(": ") + control::Name(result.halt_cause) : ""),
         1.5);
  }

  [[nodiscard]] bool open() const noexcept { return open_; }

 private:
  void Next(const std::string& text, double seconds) {
    if (open_) open_ = show_(text, seconds);
  }

  Show show_;
  bool open_ = true;
};

}  // namespace dfr::apps
