#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <exception>
#include <limits>
#include <optional>
#include <span>
#include <string_view>

#include "dfr/core/build_info.h"
#include "dfr/guard.h"
#include "dfr/safety/guard.h"

struct dfr_guard {
  dfr::safety::Guard guard;
};

namespace {

// An array, because a string would allocate, and the C library ends the process if it cannot
// register the destructor of a thread-local variable.
thread_local std::array<char, 1024> last_error{};

void SetError(std::string_view text) noexcept {
  const std::size_t size = std::min(text.size(), last_error.size() - 1);
  *std::copy_n(text.begin(), size, last_error.begin()) = '\0';
}

int32_t ModeOf(dfr::control::Mode mode) {
  using enum dfr::control::Mode;
  switch (mode) {
    case kPolicy:
      return DFR_GUARD_POLICY;
    case kProbe:
      return DFR_GUARD_PROBE;
    case kRecovery:
      return DFR_GUARD_RECOVERY;
    case kHalt:
      return DFR_GUARD_HALT;
  }
  return DFR_GUARD_HALT;
}

// A caller compiled with an older header has a shorter struct.
void Tell(const dfr_guard_verdict& whole, dfr_guard_verdict* verdict) {
  if (verdict == nullptr) return;
  const std::size_t size = std::min<std::size_t>(verdict->size, sizeof(whole));
  if (size <= sizeof(whole.size)) return;
  std::memcpy(reinterpret_cast<char*>(verdict) + sizeof(whole.size),
              reinterpret_cast<const char*>(&whole) + sizeof(whole.size),
              size - sizeof(whole.size));
}

}  // namespace

extern "C" {

dfr_guard* dfr_guard_load(const char* path) {
  try {
    if (path == nullptr) {
      SetError("dfr_guard_load: path is NULL");
      return nullptr;
    }
    return new dfr_guard{dfr::safety::Guard::Load(path)};
  } catch (const std::exception& e) {
    SetError(e.what());
  } catch (...) {
    SetError("dfr_guard_load: failed");
  }
  return nullptr;
}

void dfr_guard_free(dfr_guard* guard) { delete guard; }

int32_t dfr_guard_state_dim(const dfr_guard* guard) {
  return guard == nullptr ? 0 : guard->guard.state_dim();
}
int32_t dfr_guard_action_dim(const dfr_guard* guard) {
  return guard == nullptr ? 0 : guard->guard.action_dim();
}
int32_t dfr_guard_num_steps(const dfr_guard* guard) {
  return guard == nullptr ? 0 : guard->guard.model().num_steps();
}

void dfr_guard_reset(dfr_guard* guard, uint64_t seed) {
  if (guard != nullptr) guard->guard.Reset(seed);
}

void dfr_guard_stop(dfr_guard* guard) {
  if (guard != nullptr) guard->guard.Stop();
}

int32_t dfr_guard_filter(dfr_guard* guard, int32_t t, const double* state, size_t state_size,
                         const double* action, size_t action_size, double* safe,
                         dfr_guard_verdict* verdict) {
  dfr_guard_verdict whole{};
  whole.mode = DFR_GUARD_HALT;
  whole.changed = 1;
  whole.g = whole.threshold = std::numeric_limits<double>::quiet_NaN();
  whole.reason = "control-invalid";
  if (guard == nullptr || safe == nullptr ||
      action_size != static_cast<size_t>(guard->guard.action_dim())) {
    if (guard != nullptr) guard->guard.Stop(dfr::control::HaltCause::kControlInvalid);
    if (safe != nullptr) std::fill_n(safe, action_size, 0.0);
    Tell(whole, verdict);
    return whole.mode;
  }
  // An empty span has the wrong size, so the guard halts.
  const dfr::safety::Verdict decided = guard->guard.Filter(
      t, state == nullptr ? std::span<const double>() : std::span(state, state_size),
      action == nullptr ? std::span<const double>() : std::span(action, action_size),
      std::span(safe, action_size));
  whole.mode = ModeOf(decided.mode);
  whole.changed = decided.changed ? 1 : 0;
  whole.alarm = decided.alarm ? 1 : 0;
  whole.step = decided.step;
  whole.alarm_step = decided.alarm_step;
  whole.g = decided.g;
  whole.threshold = decided.threshold;
  whole.reason = decided.reason();
  Tell(whole, verdict);
  return whole.mode;
}

int32_t dfr_guard_decision(const dfr_guard* guard, size_t count, const int32_t* t,
                           const double* states, double* g) try {
  if (guard == nullptr || t == nullptr || states == nullptr || g == nullptr) {
    SetError(guard == nullptr    ? "dfr_guard_decision: guard is NULL"
             : t == nullptr      ? "dfr_guard_decision: t is NULL"
             : states == nullptr ? "dfr_guard_decision: states is NULL"
                                 : "dfr_guard_decision: g is NULL");
    return -1;
  }
  for (std::size_t i = 0; i < count; ++i) {
    if (t[i] >= 0) continue;
    std::array<char, 64> text{};
    std::snprintf(text.data(), text.size(), "dfr_guard_decision: t[%zu] is negative", i);
    SetError(text.data());
    return -1;
  }
  const auto dim = static_cast<std::size_t>(guard->guard.state_dim());
  const dfr::safety::GuardModel& model = guard->guard.model();
  std::optional<dfr::reduction::StateReduction::Workspace> workspace;
  if (model.reduction() != nullptr) workspace.emplace(*model.reduction());
  for (std::size_t i = 0; i < count; ++i) {
    std::span<const double> state(states + i * dim, dim);
    if (workspace) {
      model.reduction()->Apply(state, *workspace);
      state = workspace->state();
    }
    g[i] = model.support().Decision(t[i], state);
  }
  return 0;
} catch (const std::exception&) {
  SetError("dfr_guard_decision: out of memory");
  return -1;
}

const char* dfr_guard_last_error(void) { return last_error.data(); }

const char* dfr_guard_version(void) { return dfr::core::BuildVersion(); }

}  // extern "C"
