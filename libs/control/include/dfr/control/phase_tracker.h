#pragma once

#include <span>

#include "dfr/core/decision_function.h"

namespace dfr::control {

/// Tracks the phase of an episode: the time step of the demonstrations that matches its state.
/// Controllers, observers and certificates use different rules.
///
/// - A controller decides the phase. Advance() moves to the next phase once a control is predicted
/// to end inside the support of that phase. Otherwise it moves to the later phase whose support
/// fits the prediction best, because a missed support must not block the following ones. If the
/// prediction is far outside, the phase may wait. Wait() keeps the phase if a slow control ends
/// inside the present support.
/// - An observer (an alarm, a report) follows the state, because the paces of demonstrations and
/// robots differ. Follow() selects the phase near the expected one whose support fits best.
/// - A certificate holds only inside a support. Enter() selects the best nearby phase whose support
/// contains the state.
///
/// Borrows the support. Never allocates, locks or throws; one object belongs to one thread.
class PhaseTracker {
 public:
  /// Number of phases searched on either side of the expected phase.
  static constexpr int kWindow = 3;
  /// Penalty in l per phase of distance from the expected phase. It is small enough to decide only
  /// within wide supports.
  static constexpr double kPenalty = 0.05;

  explicit PhaseTracker(const core::LogDecisionFunction& support) : support_(&support) {}

  /// Starts an episode in phase `first`.
  void Reset(int first = 0) noexcept;

  /// Records a control that is predicted to end inside the support of phase() + 1.
  void Advance() noexcept;
  /// Records a control that is predicted to end at `z`, outside the support of phase() + 1, where
  /// its level is `l`. Moves to the phase whose support fits `z` best, from phase() + 1 (phase() if
  /// `may_wait`) to phase() + kWindow. If no level is finite, moves to the first of these phases.
  void Advance(std::span<const double> z, double l, bool may_wait) noexcept;
  /// Moves to the phase whose support, of all supports, contains `z` most deeply. @returns false if
  /// no support contains `z`; the phase then stays.
  bool Relocate(std::span<const double> z) noexcept;
  /// Keeps the phase for one more control.
  void Wait() noexcept { ++waited_; }
  /// Processes an observer's next state `z`. @returns l at the selected phase, -infinity for an
  /// invalid state.
  double Follow(std::span<const double> z) noexcept;
  /// Moves to the best phase q with -kWindow - 1 <= q - phase() <= kWindow and l_q(z) >= `least`.
  /// @returns l at phase(). If there is no such phase, the result is below `least` and the phase
  /// stays.
  double Enter(std::span<const double> z, double least = 0.0) noexcept;

  [[nodiscard]] int phase() const noexcept { return phase_; }
  /// Number of controls since the phase last advanced.
  [[nodiscard]] int waited() const noexcept { return waited_; }

 private:
  /// Moves to phase `q` with level `l` if its score exceeds `best`, and sets `best` to the score.
  bool Take(int q, int expected, double l, double& best) noexcept;
  double Fit(std::span<const double> z, int first, int last, int expected, double least) noexcept;

  const core::LogDecisionFunction* support_;
  int phase_ = 0;
  int expected_ = 0;
  int waited_ = 0;
};

}  // namespace dfr::control
