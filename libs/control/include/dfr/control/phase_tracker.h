#pragma once

#include <span>

#include "dfr/core/decision_function.h"

namespace dfr::control {

/// Which phase an episode is in: the time step of the demonstrations that its state belongs to.
/// There is one such rule for those who decide and one for those who watch.
///
/// - A controller decides about time. Advance() moves to the next phase once a control is predicted
///   to end inside its support. Otherwise it moves to the one ahead whose support fits the
///   prediction best: a support that was missed must not hold up those that follow. Outside, the
///   phase may wait.
/// - An observer (an alarm, a report) has to follow, because demonstrations and robots go at paces
///   of their own. Follow() takes the phase near the expected one whose support fits best.
/// - A certificate holds only inside. Enter() takes the best phase near whose support the state is
///   in.
///
/// Borrows the support. Never allocates, locks or throws; one object belongs to one thread.
class PhaseTracker {
 public:
  /// Phases that are looked at to either side of the expected one.
  static constexpr int kWindow = 3;
  /// What a phase to the side costs, in l, for each phase between: so little that within a wide
  /// support the clock decides.
  static constexpr double kPenalty = 0.05;

  explicit PhaseTracker(const core::LogDecisionFunction& support) : support_(&support) {}

  /// Starts an episode in phase `first`.
  void Reset(int first = 0) noexcept;

  /// A control was chosen that is predicted to end inside the support of phase() + 1.
  void Advance() noexcept;
  /// A control was chosen that is predicted to end at `z`, outside the support of phase() + 1, at
  /// level `l` of it: moves to the phase from phase() + 1, or from phase() where it `may_wait`, to
  /// phase() + kWindow whose support fits `z` best, phase() + 1 in doubt.
  void Advance(std::span<const double> z, double l, bool may_wait) noexcept;
  /// The phase stays for one more control.
  void Wait() noexcept { ++waited_; }
  /// The next of an observer's states is `z`. @returns l at the phase it is taken to be in,
  ///   -infinity for a state that is not one.
  double Follow(std::span<const double> z) noexcept;
  /// Moves to a phase q with -kWindow - 1 <= q - phase() <= kWindow and l_q(z) >= `least`.
  /// @returns l at phase(), below `least` if there is none; the phase then stays.
  double Enter(std::span<const double> z, double least = 0.0) noexcept;

  [[nodiscard]] int phase() const noexcept { return phase_; }
  /// Controls since the phase last advanced.
  [[nodiscard]] int waited() const noexcept { return waited_; }

 private:
  /// Moves to phase `q`, whose support z is at level `l` of, if it fits better than `best`, its
  /// score then.
  bool Take(int q, int expected, double l, double& best) noexcept;
  double Fit(std::span<const double> z, int first, int last, int expected, double least) noexcept;

  const core::LogDecisionFunction* support_;
  int phase_ = 0;
  int expected_ = 0;
  int waited_ = 0;
};

}  // namespace dfr::control
