#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/plant.h"
#include "dfr/core/random.h"
#include "dfr/core/trajectory.h"

namespace dfr::sim {

/// What a supervisor made up its mind about before a demonstration.
struct Habit {
  double way = 0.5;     ///< Uniform in [0, 1): which of several ways it takes.
  double offset = 0.0;  ///< Standard normal: how far to the side it keeps.
};

/// The plant of one small task: deterministic physics in a few numbers, thousands of episodes a
/// second. Lengths, angles and times have units of their own in each task.
///
/// Control: entries saturate at +-1. A control of another size or with a non-finite entry is
/// refused. One object belongs to one thread.
class GalleryPlant : public core::SimulatedPlant {
 public:
  [[nodiscard]] const core::StateLayout& layout() const noexcept final { return layout_; }
  [[nodiscard]] int control_dim() const noexcept final { return static_cast<int>(control_.size()); }
  void Reset(std::uint64_t seed) final;
  [[nodiscard]] core::PlantStatus Apply(std::span<const double> control) noexcept final;
  void Observe(std::span<double> state) const noexcept final;
  [[nodiscard]] bool completed() const noexcept final { return completed_ && !failed_; }
  [[nodiscard]] bool collided() const noexcept final { return failed_; }
  void Halt() noexcept final {}
  void CopyStateFrom(const core::SimulatedPlant& other) noexcept final;

  /// What a supervisor of this habit does in the present state, without noise. It sees all of the
  /// state, hidden entries included. Entries of `u` may exceed +-1.
  virtual void Supervise(const Habit& habit, std::span<double> u) const noexcept = 0;

 protected:
  /// @param hidden  entries of the state behind those of `layout`, which nobody observes.
  GalleryPlant(std::vector<core::StateLayout::Block> blocks, int hidden, int control_dim);

  [[nodiscard]] double& x(int i) noexcept { return state_[static_cast<std::size_t>(i)]; }
  [[nodiscard]] double x(int i) const noexcept { return state_[static_cast<std::size_t>(i)]; }
  void FailIf(bool failed) noexcept { failed_ = failed_ || failed; }

 private:
  /// Draws the start state; all entries are zero before.
  virtual void Start(core::Random& random) noexcept = 0;
  /// Moves the world by one control, whose entries lie within +-1, and calls FailIf().
  virtual void Step(std::span<const double> u) noexcept = 0;
  [[nodiscard]] virtual bool Done() const noexcept = 0;

  core::StateLayout layout_;
  std::vector<double> state_;
  std::vector<double> control_;  // saturated, so that Apply() does not allocate
  bool failed_ = false;
  bool completed_ = false;
};

/// In what way the biased policy of a task is wrong. How much differs between episodes: a share of
/// the figures below that is uniform in [0, 1], of `late` a whole number uniform in {0, ..., late}.
struct Flaw {
  std::vector<double> bias = {};  ///< Added to the first entries of every control.
  double turn = 0.0;              ///< rad: the first two entries are turned by this.
  int late = 0;                   ///< Controls come this many steps late; zeros come first.
};

/// One task: what happens, who demonstrates it, and who imitates that how well. Controllers are
/// told the layout, the demonstrations and `features`.
struct GalleryTask {
  std::string name;
  std::string summary;     ///< What is to be done, what fails, what is difficult.
  bool judgement = false;  ///< Kept for the final judgement: nothing is chosen on it.
  std::shared_ptr<const GalleryPlant> plant;  ///< To be cloned.
  std::string features = {};                  ///< What a guard looks at; empty: all.
  int horizon = 100;                          ///< Controls that a supervisor needs at most.
  /// Zero where a control of zero holds everything still. Elsewhere the world moves on, and an
  /// episode does so for this many controls of zero after a halt: a halt may fail.
  int aftermath = 0;
  double noise = 0.2;  ///< Standard deviation of the supervisor's noise, in each entry.
  /// Controls of a demonstration are scaled by one factor, between these and uniform in its
  /// logarithm.
  double slowest = 1.0;
  double fastest = 1.0;
  double pause = 0.0;  ///< Probability that a pause of 5 to 30 steps begins, at each step.
  std::vector<int> hidden = {64, 64};  ///< Units of the good policy,
  int epochs = 100;                    ///< and how often it sees the demonstrations.
  std::vector<int> weak_hidden = {8};  ///< The same of the weak one.
  int weak_epochs = 10;
  Flaw flaw = {};  ///< Makes the biased policy of the good one.
};

/// All tasks, design and judgement, in a fixed order.
[[nodiscard]] const std::vector<GalleryTask>& GalleryTasks();
/// @throws std::invalid_argument naming the tasks there are.
[[nodiscard]] const GalleryTask& FindGalleryTask(std::string_view name);

/// One demonstration, whatever comes of it; the seed decides start state, habit and noise.
[[nodiscard]] core::Trajectory DemonstrateOnce(const GalleryTask& task, std::uint64_t seed);
/// Demonstrations that completed the task; others are discarded.
/// @throws std::runtime_error if the supervisor hardly ever succeeds.
[[nodiscard]] std::vector<core::Trajectory> Demonstrate(const GalleryTask& task, int count,
                                                        std::uint64_t seed);

}  // namespace dfr::sim
