#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "geometry.h"
#include "tasks/tasks.h"

namespace dfr::sim::internal {
namespace {

// Returns the positions of the joints and the tip of a planar chain of equal links. `joint` returns
// the angle of a joint by its index.
template <std::size_t N>
std::array<Point, N + 1> ChainPoints(Point base, double link, const auto& joint) noexcept {
  std::array<Point, N + 1> points{base};
  double angle = 0.0;
  for (std::size_t i = 0; i < N; ++i) {
    angle += joint(static_cast<int>(i));
    points[i + 1] = points[i] + Turned({link, 0.0}, angle);
  }
  return points;
}

// Returns true if a link of the chain reaches into the disc.
template <std::size_t N>
bool Touches(const std::array<Point, N>& points, const Disc& disc) noexcept {
  for (std::size_t i = 0; i + 1 < N; ++i) {
    if (disc.Contains(Nearest(points[i], points[i + 1], disc.centre))) return true;
  }
  return false;
}

// Writes the joint motion for the tip motion `wanted`: J' (J J' + damping)^-1 `wanted`.
template <std::size_t N>
void MoveTip(const std::array<Point, N + 1>& points, Point wanted,
             std::span<double, N> motion) noexcept {
  std::array<Point, N> columns;
  double a = 1e-3, b = 0.0, d = 1e-3;
  for (std::size_t i = 0; i < N; ++i) {
    const Point r = points[N] - points[i];
    columns[i] = {-r.y, r.x};
    a += columns[i].x * columns[i].x;
    b += columns[i].x * columns[i].y;
    d += columns[i].y * columns[i].y;
  }
  const double det = a * d - b * b;
  const Point f{(d * wanted.x - b * wanted.y) / det, (a * wanted.y - b * wanted.x) / det};
  for (std::size_t i = 0; i < N; ++i) motion[i] = Dot(columns[i], f);
}

// A planar arm of two links. State: joints(2), tip(2).
class Arm2Plant final : public Cloned<Arm2Plant> {
  static constexpr double kLink = 0.5;
  static constexpr double kStep = 0.25;  // rad, rotation of a joint by a control of 1
  static constexpr Disc kPillar{{0.327, 0.642}, 0.16};
  static constexpr Point kGoal{-0.417, 0.712};

  static Point Elbow(double shoulder) noexcept { return Turned({kLink, 0.0}, shoulder); }
  static Point Tip(double shoulder, double elbow) noexcept {
    return Elbow(shoulder) + Turned({kLink, 0.0}, shoulder + elbow);
  }

 public:
  Arm2Plant() : Cloned({{"joints", 0, 2}, {"tip", 0, 2}}, 0, 2) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    // Folds the elbow before the pillar and unfolds it behind the pillar.
    const double fold = 2.15 + 0.03 * variation.offset;
    const std::array<Point, 4> path{{{-0.3, 0.9}, {-0.2, fold}, {1.0, fold}, {1.5, 1.2}}};
    const Point q{x(0), x(1)};
    const Point wanted = Shortened((1.0 / kStep) * (Ahead(path, q, kStep) - q), 1.0);
    u[0] = wanted.x;
    u[1] = wanted.y;
  }

 private:
  void Place() noexcept {
    const Point tip = Tip(x(0), x(1));
    x(2) = tip.x;
    x(3) = tip.y;
  }
  void Start(core::Random& random) noexcept override {
    x(0) = -0.3 + random.Uniform(-0.06, 0.06);
    x(1) = 0.9 + random.Uniform(-0.06, 0.06);
    Place();
  }
  void Step(std::span<const double> u) noexcept override {
    constexpr int kLooks = 4;
    for (int look = 0; look < kLooks; ++look) {
      x(0) += kStep / kLooks * u[0];
      x(1) += kStep / kLooks * u[1];
      Place();
      const Point elbow = Elbow(x(0));
      const Point c = kPillar.centre;
      FailIf(kPillar.Contains(Nearest({}, elbow, c)) ||
             kPillar.Contains(Nearest(elbow, {x(2), x(3)}, c)));
      FailIf(std::abs(x(0)) > 2.0 || std::abs(x(1)) > 2.9);
    }
  }
  [[nodiscard]] bool Done() const noexcept override {
    return Norm(Point{x(2), x(3)} - kGoal) < 0.08;
  }
};

// A planar arm of equal links, which reaches from below a pillar to a goal above it. State:
// joints(N) in rad, tip(2), then hidden entries.
template <typename Derived, int N>
class ChainPlant : public Cloned<Derived> {
 protected:
  static constexpr int kJoints = N;
  static constexpr Disc kPillar{{0.8, 0.0}, 0.12};
  static constexpr Disc kGoal{{0.72, 0.36}, 0.05};
  using Cloned<Derived>::x;

  // The mean start pose is bent away from the pillar.
  ChainPlant(const std::array<double, N>& start, int hidden)
      : Cloned<Derived>({{"joints", 0, N}, {"tip", 0, 2}}, hidden, N), start_(start) {}

  [[nodiscard]] std::array<Point, N + 1> Points() const noexcept {
    return ChainPoints<N>({}, 1.0 / N, [this](int i) { return x(i); });
  }
  void Place() noexcept {
    const Point tip = Points().back();
    x(N) = tip.x;
    x(N + 1) = tip.y;
  }

 private:
  void Start(core::Random& random) noexcept final {
    for (int i = 0; i < N; ++i) {
      x(i) = start_[static_cast<std::size_t>(i)] + random.Uniform(-0.04, 0.04);
    }
    Place();
  }
  [[nodiscard]] bool Done() const noexcept final { return kGoal.Contains({x(N), x(N + 1)}); }

  std::array<double, N> start_;
};

// A planar arm of seven joints.
class Arm7Plant final : public ChainPlant<Arm7Plant, 7> {
  static constexpr double kStep = 0.1;  // rad, joint rotation by a control of 1

 public:
  Arm7Plant() : ChainPlant({-1.5, 0.4, 0.35, 0.3, 0.25, 0.2, 0.2}, 0) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const double inner = 0.52 + 0.015 * variation.offset;
    const std::array<Point, 4> path{{{0.72, -0.36}, {inner, -0.12}, {inner, 0.12}, kGoal.centre}};
    const Point tip{x(kJoints), x(kJoints + 1)};
    const Point wanted = Shortened(Ahead(path, tip, 0.06) - tip, 0.05);
    MoveTip(Points(), wanted, u.first<kJoints>());
    for (double& entry : u) entry /= kStep;
  }

 private:
  void Step(std::span<const double> u) noexcept override {
    constexpr int kLooks = 2;
    for (int look = 0; look < kLooks; ++look) {
      for (int i = 0; i < kJoints; ++i) {
        x(i) += kStep / kLooks * u[static_cast<std::size_t>(i)];
        FailIf(std::abs(x(i)) > 2.5);
      }
      FailIf(Touches(Points(), kPillar));
    }
    Place();
  }
};

// An arm whose servos move the joints to absolute targets. A control is the target minus the
// measured joint, rad, as in a conversion of absolute targets. Half of a motion carries over to the
// next step, and the shoulder sags slightly. Hidden: the last motion(5).
class JointsPlant final : public ChainPlant<JointsPlant, 5> {
  static constexpr double kCarry = 0.5;
  static constexpr double kSag = 0.003;  // rad, sag per step at a horizontal first link
  static constexpr double kMost = 0.12;  // rad, maximum distance of a target from the joint

 public:
  JointsPlant() : ChainPlant({-1.25, 0.5, 0.4, 0.3, 0.25}, kJoints) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const double inner = 0.5 + 0.015 * variation.offset;
    const std::array<Point, 4> path{{{0.75, -0.34}, {inner, -0.12}, {inner, 0.12}, kGoal.centre}};
    const auto points = Points();
    MoveTip(points, Shortened(Ahead(path, points.back(), 0.07) - points.back(), 0.05),
            u.first<kJoints>());
    for (double& entry : u) entry = std::clamp(entry, -kMost, kMost);
  }

 private:
  void Step(std::span<const double> u) noexcept override {
    constexpr int kMotion = kJoints + 2;
    for (int i = 0; i < kJoints; ++i) {
      x(kMotion + i) = kCarry * x(kMotion + i) + (1.0 - kCarry) * u[static_cast<std::size_t>(i)];
    }
    constexpr int kLooks = 3;
    for (int look = 0; look < kLooks; ++look) {
      x(0) -= kSag / kLooks * std::cos(x(0));
      for (int i = 0; i < kJoints; ++i) {
        x(i) += x(kMotion + i) / kLooks;
        FailIf(std::abs(x(i)) > 2.5);
      }
      FailIf(Touches(Points(), kPillar));
    }
    Place();
  }
};

// Two planar arms of seven joints carry a bar between their tips past a post. 30 observed entries
// follow from 14 joints.
// State: left(7) and right(7) in rad, tips(4), headings(2) in rad, elbows(4), bar(3) as centre and
// tilt, gap(1) between the tips, goal(2) minus the bar's centre.
class BimanualPlant final : public Cloned<BimanualPlant> {
  static constexpr int kJoints = 7;
  static constexpr double kLink = 1.0 / kJoints;
  static constexpr double kStep = 0.1;  // rad, joint rotation by a control of 1
  static constexpr double kBase = 0.35;
  static constexpr double kLength = 0.3;  // length of the bar
  static constexpr double kPlay = 0.12;   // maximum deviation of the gap from kLength
  static constexpr double kTilt = 0.5;
  static constexpr Disc kPost{{-0.2, 0.72}, 0.06};
  static constexpr Disc kGoal{{0.12, 0.72}, 0.04};
  static constexpr std::array<double, kJoints> kPosture = {2.92,  -0.45, -0.45, -0.45,
                                                           -0.45, -0.45, -0.45};
  using Chain = std::array<Point, kJoints + 1>;

 public:
  BimanualPlant()
      : Cloned({{"left", 0, kJoints},
                {"right", 0, kJoints},
                {"tips", 0, 4},
                {"headings", 0, 2},
                {"elbows", 0, 4},
                {"bar", 0, 3},
                {"gap", 0, 1},
                {"goal", 0, 2}},
               0, 2 * kJoints) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const double side = 0.12 + 0.006 * variation.offset;
    const std::array<Point, 4> path{{{-0.1, 0.5}, {side, 0.54}, {side, 0.66}, kGoal.centre}};
    const Point centre{x(24), x(25)};
    const Point aim = centre + Shortened(Ahead(path, centre, 0.04) - centre, 0.012);
    for (int arm = 0; arm < 2; ++arm) {
      const Chain points = Points(arm);
      const Point target = aim + Point{(arm - 0.5) * kLength, 0.0};
      const std::span<double, kJoints> motion(u.data() + arm * kJoints, kJoints);
      MoveTip(points, Shortened(target - points.back(), 0.04), motion);
      for (double& entry : motion) entry /= kStep;
    }
  }

 private:
  [[nodiscard]] Chain Points(int arm) const noexcept {
    return ChainPoints<kJoints>({arm == 0 ? -kBase : kBase, 0.0}, kLink,
                                [&](int i) { return x(arm * kJoints + i); });
  }
  void Place() noexcept {
    std::array<Point, 2> tips{};
    for (int arm = 0; arm < 2; ++arm) {
      const Chain points = Points(arm);
      const Point tip = tips[static_cast<std::size_t>(arm)] = points.back();
      x(14 + 2 * arm) = tip.x;
      x(15 + 2 * arm) = tip.y;
      x(18 + arm) = 0.0;
      for (int i = 0; i < kJoints; ++i) x(18 + arm) += x(arm * kJoints + i);
      x(20 + 2 * arm) = points[4].x;
      x(21 + 2 * arm) = points[4].y;
    }
    const Point bar = tips[1] - tips[0];
    x(24) = 0.5 * (tips[0].x + tips[1].x);
    x(25) = 0.5 * (tips[0].y + tips[1].y);
    x(26) = std::atan2(bar.y, bar.x);
    x(27) = Norm(bar);
    x(28) = kGoal.centre.x - x(24);
    x(29) = kGoal.centre.y - x(25);
  }
  void Start(core::Random& random) noexcept override {
    for (int i = 0; i < kJoints; ++i) {
      const double posture = kPosture[static_cast<std::size_t>(i)];
      x(i) = posture + random.Uniform(-0.04, 0.04);
      x(kJoints + i) = (i == 0 ? std::numbers::pi - posture : -posture);
      x(kJoints + i) += random.Uniform(-0.04, 0.04);
    }
    const Point centre{-0.1 + random.Uniform(-0.02, 0.02), 0.5 + random.Uniform(-0.02, 0.02)};
    std::array<double, kJoints> motion{};
    constexpr int kIterations = 60;
    for (int k = 0; k < kIterations; ++k) {
      for (int arm = 0; arm < 2; ++arm) {
        const Chain points = Points(arm);
        const Point target = centre + Point{(arm - 0.5) * kLength, 0.0};
        MoveTip(points, Shortened(target - points.back(), 0.05), std::span(motion));
        for (int i = 0; i < kJoints; ++i) {
          x(arm * kJoints + i) += motion[static_cast<std::size_t>(i)];
        }
      }
    }
    Place();
  }
  void Step(std::span<const double> u) noexcept override {
    constexpr int kLooks = 2;
    for (int look = 0; look < kLooks; ++look) {
      for (int i = 0; i < 2 * kJoints; ++i) {
        x(i) += kStep / kLooks * u[static_cast<std::size_t>(i)];
      }
      Place();
      FailIf(std::abs(x(27) - kLength) > kPlay || std::abs(x(26)) > kTilt);
      FailIf(kPost.Contains(Nearest({x(14), x(15)}, {x(16), x(17)}, kPost.centre)));
    }
  }
  [[nodiscard]] bool Done() const noexcept override { return kGoal.Contains({x(24), x(25)}); }
};

}  // namespace

GalleryTask Arm2Task() {
  return {.name = "arm2",
          .summary =
              "An arm of two joints folds past a pillar; an action is longer than the distance "
              "between demonstrations; any part touching the pillar fails",
          .plant = std::make_shared<Arm2Plant>(),
          .features = "joints",
          .horizon = 60,
          .noise = 0.15,
          .weak_hidden = {4},
          .weak_epochs = 20,
          .policy_bias = {.late = 4}};
}

GalleryTask Arm7Task() {
  return {.name = "arm7",
          .summary =
              "An arm of seven joints moves its tip round a pillar, on the near side; any "
              "part touching it fails",
          .held_out = true,
          .plant = std::make_shared<Arm7Plant>(),
          .features = "joints",
          .noise = 0.1,
          .hidden = {32},
          .epochs = 60,
          .weak_epochs = 25,
          .policy_bias = {.bias = {-0.25}}};
}

GalleryTask JointsTask() {
  return {.name = "joints",
          .summary =
              "Absolute joint targets minus the measured joints move the tip of an arm round a "
              "pillar: the servo lags and sags; any part touching the pillar fails",
          .plant = std::make_shared<JointsPlant>(),
          .settle_steps = 10,
          .noise = 0.1,
          .units = std::vector<double>(5, 0.12),
          .weak_epochs = 20,
          .policy_bias = {.bias = {-0.03}}};
}

GalleryTask BimanualTask() {
  return {.name = "bimanual",
          .summary =
              "Two arms of seven joints carry a bar past a post; 30 features follow from 14 "
              "joints; pulling, squeezing or tilting the bar, or touching the post, fails",
          .held_out = true,
          .plant = std::make_shared<BimanualPlant>(),
          .features = "bar,gap",  // A fit to all 30 features, which are redundant, is refused.
          .noise = 0.05,
          .hidden = {32},
          .epochs = 60,
          .weak_hidden = {16},
          .weak_epochs = 25,
          .policy_bias = {.bias = {0.15}}};
}

}  // namespace dfr::sim::internal
