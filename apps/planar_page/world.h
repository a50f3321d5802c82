#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "apps/planar_page/scene.h"
#include "apps/study/planar/polynomial_policy.h"
#include "dfr/control/certified/certificate.h"
#include "dfr/control/controller.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"
#include "dfr/safety/task_model.h"

namespace dfr::apps::planar_page {

/// A learned policy plus a disturbance of its controls that the user sets.
class PushedPolicy final : public core::Policy {
 public:
  explicit PushedPolicy(const core::Policy& learned) : learned_(&learned) {}
  [[nodiscard]] int state_dim() const noexcept override { return 2; }
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override;
  /// Adds `push` to every later control, in the robot's axes.
  void set_push(const Point& push) noexcept { push_ = push; }

 private:
  const core::Policy* learned_;
  Point push_{};
};

/// Support of Algorithm 1, of guided recovery or of the certified method.
enum class Support { kPublished, kGuided, kCertified };

/// Names of the methods, as in the program `study`.
[[nodiscard]] const std::vector<std::string>& MethodNames();
[[nodiscard]] Support SupportOf(std::size_t method) noexcept;

/// Region that a certificate allows in one state, in the plane's unit of length. By the curvature
/// bound, any motion that ends in this disc stays inside the support.
struct SafeRegion {
  Point centre{};
  double radius = 0.0;  ///< Negative outside the support: nothing is certified there.
};

/// One control of an episode.
struct Decision {
  control::Step step;
  Point from{};
  Point to{};      ///< Equal to `from` after a halt.
  Point wanted{};  ///< Target of the policy, including pushes.
};

/// An episode: a controller moves the point until it completes, collides or halts.
class Episode {
 public:
  Episode(const Scene& scene, const PushedPolicy& policy,
          std::unique_ptr<control::Controller> controller, std::uint64_t seed);
  /// Applies one control. Does nothing once over().
  Decision Step() noexcept;
  [[nodiscard]] PointPlant& plant() noexcept { return plant_; }
  [[nodiscard]] const PointPlant& plant() const noexcept { return plant_; }
  [[nodiscard]] bool over() const noexcept;
  /// Valid once over(). Returns kHalted, with cause(), if the point neither completed nor collided.
  [[nodiscard]] core::Outcome outcome() const noexcept;
  [[nodiscard]] control::HaltCause cause() const noexcept { return cause_; }

 private:
  static constexpr int kMostControls = 2000;
  PointPlant plant_;
  const PushedPolicy* policy_;
  std::unique_ptr<control::Controller> controller_;
  control::HaltCause cause_ = control::HaltCause::kNone;
  int t_ = 0;
  int controls_ = 0;
};

/// Outcomes of episodes from random start states.
struct Tally {
  int completed = 0;
  int halted = 0;
  int collided = 0;
};

/// Computations of the page: demonstrations, models learned from them, and episodes. Belongs to one
/// thread.
class World {
 public:
  /// @throws std::out_of_range for an unknown scene.
  explicit World(std::size_t scene);
  World(const World&) = delete;
  World& operator=(const World&) = delete;
  ~World();

  [[nodiscard]] const Scene& scene() const noexcept { return *scene_; }
  [[nodiscard]] const PointPlant& plant() const noexcept { return plant_; }

  /// Adds `count` demonstrations along alternating routes of the scene.
  void Demonstrate(int count, std::uint64_t seed);
  /// Adds the line that a user drew as a demonstration, and `repeats` demonstrations that follow
  /// the line with noise.
  /// @throws std::invalid_argument with the reason for the user.
  void Draw(std::span<const Point> line, int repeats, std::uint64_t seed);
  /// Removes all demonstrations and models.
  void Clear();
  [[nodiscard]] const std::vector<core::Trajectory>& demonstrations() const noexcept {
    return demonstrations_;
  }

  /// Learns policy, supports and recoveries from the demonstrations.
  /// @throws std::invalid_argument if there are too few.
  void Fit();
  [[nodiscard]] bool fitted() const noexcept { return learned_ != nullptr; }
  /// Fits the additional parts of the certified method, unless they exist. Requires fitted(). Takes
  /// as long as Fit(). A page can show the results of Fit() during that time.
  void FitCertified();
  [[nodiscard]] bool fitted_certified() const noexcept;

  // The other functions require fitted(), and fitted_certified() for Support::kCertified, a
  // certified method or Certified().

  [[nodiscard]] int num_steps(Support support) const noexcept;
  /// Return l_t(x), the log form of g_t(x), and g_t(x).
  [[nodiscard]] double LogDecision(Support support, int t, const Point& x) const noexcept;
  [[nodiscard]] double Decision(Support support, int t, const Point& x) const noexcept;
  /// Returns the time step with the largest l_t(x).
  [[nodiscard]] int NearestStep(Support support, const Point& x) const noexcept;
  [[nodiscard]] SafeRegion Certified(int t, const Point& x) const noexcept;

  /// Begins an episode of this method (an index of MethodNames()) from `start`, at time step
  /// `first_step`.
  [[nodiscard]] Episode Start(std::size_t method, const Point& start, int first_step,
                              std::uint64_t seed) const;
  /// Adds the control for this motion to the policy's controls, except in the episodes of Run().
  void Push(const Point& displacement) noexcept;
  /// Runs `count` episodes from random start states, without pushes.
  [[nodiscard]] Tally Run(std::size_t method, int count, std::uint64_t seed) const;

 private:
  struct Learned;
  [[nodiscard]] std::optional<core::Trajectory> Follow(const std::vector<Point>& route,
                                                       bool unsteady, std::uint64_t seed) const;
  [[nodiscard]] const core::LogDecisionFunction& Chosen(Support support) const noexcept;

  const Scene* scene_;
  PointPlant plant_;
  std::vector<core::Trajectory> demonstrations_;
  std::unique_ptr<Learned> learned_;
};

}  // namespace dfr::apps::planar_page
