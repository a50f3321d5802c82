#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/plant.h"
#include "dfr/sim/gallery/corridor.h"

namespace dfr::apps::planar_page {

using Point = std::array<double, 2>;

struct Disc {
  Point centre;
  double radius;
};
struct Box {
  Point low;
  Point high;
};

/// One prepared task of the page: a point robot goes from a start to a goal and touches nothing.
/// Lengths share one arbitrary unit.
struct Scene {
  std::string name;
  std::string summary;
  Disc start;  ///< Episodes begin within it.
  Disc goal;   ///< Entering it completes the task.
  std::vector<Disc> discs = {};
  std::vector<Box> boxes = {};
  bool corridor = false;  ///< True if the scene has the walls of sim::CorridorPlant.
  /// Routes of the demonstrator from the start to the goal, used alternately.
  std::vector<std::vector<Point>> routes = {};
  double wander = 0.05;  ///< Standard deviation of the demonstrator's distance from its route.
  int degree = 3;        ///< The learned policy is a polynomial of this degree.
};

[[nodiscard]] const std::vector<Scene>& Scenes();

/// A point among the obstacles of a scene: x' = x + K R u, as in sim::CorridorPlant. Controllers
/// get neither the obstacles nor the rotation R.
///
/// State: point(2). Control (2): entries saturate at +-1. One object belongs to one thread.
class PointPlant final : public core::SimulatedPlant {
 public:
  /// K: distance that a control of norm 1 moves the point.
  static constexpr double kGain = 0.1;
  static constexpr double kRotation = 0.6;  ///< rad

  explicit PointPlant(const Scene& scene);

  [[nodiscard]] const core::StateLayout& layout() const noexcept override { return layout_; }
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  void Reset(std::uint64_t seed) override;
  /// Moves the point to another position, and updates collided() for it.
  void MoveTo(const Point& point) noexcept;
  [[nodiscard]] core::PlantStatus Apply(std::span<const double> control) noexcept override;
  void Observe(std::span<double> state) const noexcept override;
  [[nodiscard]] bool completed() const noexcept override;
  [[nodiscard]] bool collided() const noexcept override { return collided_; }
  void Halt() noexcept override {}
  [[nodiscard]] std::unique_ptr<core::SimulatedPlant> Clone() const override;
  void CopyStateFrom(const core::SimulatedPlant& other) noexcept override;

  [[nodiscard]] const Point& point() const noexcept { return point_; }
  /// Distance to the nearest obstacle, negative inside one.
  [[nodiscard]] double Clearance(const Point& p) const noexcept;
  /// Same as sim::CorridorPlant::Wall(); empty if the scene has no corridor.
  [[nodiscard]] std::vector<Point> Wall(double side, double left, double right) const;

 private:
  Scene scene_;
  core::StateLayout layout_;
  std::optional<sim::CorridorPlant> corridor_;
  Point point_{};
  bool collided_ = false;
};

/// Converts controls to motions of the point, and back.
[[nodiscard]] Point Displacement(const Point& control) noexcept;
[[nodiscard]] Point ControlFor(const Point& displacement) noexcept;

/// Arithmetic of vectors in the plane.
inline Point operator+(const Point& a, const Point& b) { return {a[0] + b[0], a[1] + b[1]}; }
inline Point operator-(const Point& a, const Point& b) { return {a[0] - b[0], a[1] - b[1]}; }
inline Point operator*(double s, const Point& p) { return {s * p[0], s * p[1]}; }
[[nodiscard]] double Norm(const Point& p);
/// Clips the entries of a control to +-1.
[[nodiscard]] Point Saturated(const Point& u);

}  // namespace dfr::apps::planar_page
