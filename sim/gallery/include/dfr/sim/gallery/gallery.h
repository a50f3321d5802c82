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
#include "dfr/sim/gallery/canvas.h"

namespace dfr::sim {

/// A supervisor's choices before a demonstration.
struct SupervisorVariation {
  double way = 0.5;     ///< Uniform in [0, 1): selects one of several routes.
  double offset = 0.0;  ///< Standard normal: lateral offset of the path.
};

/// Plant of one small task with deterministic physics, which runs thousands of episodes a second.
/// Units of length, angle and time are specific to each task.
///
/// Control: entries saturate at +-1. A control of another size or with a non-finite entry is
/// rejected. Each object belongs to one thread.
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

  /// Writes the control of a supervisor with this variation in the current state, without noise.
  /// The supervisor uses the whole state, including hidden entries. Entries of `u` may exceed +-1.
  virtual void Supervise(const SupervisorVariation& variation,
                         std::span<double> u) const noexcept = 0;

  /// Side of a picture, in pixels.
  static constexpr int kPictureSide = 64;
  /// Draws an observed state, seen from above or from the side, to kPictureSide x kPictureSide x 3
  /// bytes: RGB, rows from the top. @returns false if the task has no pictures.
  virtual bool Draw(std::span<const double> /*state*/,
                    std::span<std::uint8_t> /*rgb*/) const noexcept {
    return false;
  }

 protected:
  /// @param hidden  number of state entries after the blocks; they are never observed.
  GalleryPlant(std::vector<core::StateLayout::Block> blocks, int hidden, int control_dim);

  [[nodiscard]] double& x(int i) noexcept { return state_[static_cast<std::size_t>(i)]; }
  [[nodiscard]] double x(int i) const noexcept { return state_[static_cast<std::size_t>(i)]; }
  void FailIf(bool failed) noexcept { failed_ = failed_ || failed; }

 private:
  /// Samples the start state; all entries are zero before the call.
  virtual void Start(core::Random& random) noexcept = 0;
  /// Advances the world by one control, whose entries are within +-1, and calls FailIf().
  virtual void Step(std::span<const double> u) noexcept = 0;
  [[nodiscard]] virtual bool Done() const noexcept = 0;

  core::StateLayout layout_;
  std::vector<double> state_;
  std::vector<double> control_;  // saturated control; a member because Apply() must not allocate
  bool failed_ = false;
  bool completed_ = false;
};

/// Errors of a task's biased policy. Their size varies by episode: a fraction of the values below,
/// uniform in [0, 1]; for `late`, an integer uniform in {0, ..., late}.
struct PolicyBias {
  std::vector<double> bias = {};  ///< Added to the first entries of every control.
  double turn = 0.0;              ///< Rotation of the first two entries, rad.
  int late = 0;                   ///< Delay of controls in steps; the first controls are zero.
};

/// One task: its plant, its supervisor, and the quality of its policies. Controllers receive only
/// the layout, the demonstrations and `features`.
struct GalleryTask {
  std::string name;
  std::string summary;    ///< Goal, failure and difficulty of the task.
  bool held_out = false;  ///< Held out for the final evaluation: no choice depends on it.
  std::shared_ptr<const GalleryPlant> plant;  ///< Cloned before use.
  std::string features = {};                  ///< Features of a guard; empty: all.
  int horizon = 100;                          ///< Maximum number of controls of a supervisor.
  /// Number of zero controls after a halt. Zero if a zero control holds everything still. In other
  /// tasks the world keeps moving, and an episode may fail after a halt.
  int settle_steps = 0;
  double noise = 0.2;  ///< Standard deviation of the supervisor's noise per entry.
  /// Scale of each entry of a control, for example metres. Noise and the targets of the learners
  /// are multiples of it. Empty: 1 for all entries.
  std::vector<double> units = {};
  std::vector<int> switches = {};  ///< Control entries that are +1 or -1 and have no noise.
  /// Range of a factor on all controls of a demonstration, uniform in its logarithm.
  double slowest = 1.0;
  double fastest = 1.0;
  double pause = 0.0;                  ///< Probability per step of a pause of 5 to 30 steps.
  std::vector<int> hidden = {64, 64};  ///< Hidden units of the good policy.
  int epochs = 100;                    ///< Training epochs of the good policy.
  std::vector<int> weak_hidden = {8};  ///< Hidden units of the weak policy.
  int weak_epochs = 10;
  PolicyBias policy_bias = {};  ///< Turns the good policy into the biased policy.
};

/// Returns all tasks, design and held-out, in a fixed order.
[[nodiscard]] const std::vector<GalleryTask>& GalleryTasks();
/// @throws std::invalid_argument listing the valid names.
[[nodiscard]] const GalleryTask& FindGalleryTask(std::string_view name);

/// Returns one demonstration with any outcome. The seed determines start state, variation and
/// noise.
[[nodiscard]] core::Trajectory DemonstrateOnce(const GalleryTask& task, std::uint64_t seed);
/// Returns demonstrations that complete the task and discards others.
/// @throws std::runtime_error if the supervisor rarely succeeds.
[[nodiscard]] std::vector<core::Trajectory> Demonstrate(const GalleryTask& task, int count,
                                                        std::uint64_t seed);

}  // namespace dfr::sim
