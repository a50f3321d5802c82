#include "apps/planar_page/world.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <utility>

#include "dfr/control/certified/certificate_constants.h"
#include "dfr/control/certified/certified_controller.h"
#include "dfr/core/contract.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/core/random.h"
#include "dfr/core/record.h"
#include "dfr/kernel/time_varying_support.h"
#include "dfr/safety/method.h"

namespace dfr::apps::planar_page {
namespace {

constexpr double kSpeed = 0.6;      // Norm of a demonstrated control.
constexpr double kUnsteady = 0.35;  // Standard deviation of the noise on each control entry.
constexpr int kHorizon = 200;       // Maximum number of controls in a demonstration.

// A polyline parametrised by arc length.
class Route {
 public:
  explicit Route(std::vector<Point> points) : points_(std::move(points)), at_(points_.size(), 0.0) {
    for (std::size_t i = 1; i < points_.size(); ++i) {
      at_[i] = at_[i - 1] + Norm(points_[i] - points_[i - 1]);
    }
  }
  [[nodiscard]] double length() const { return at_.back(); }
  [[nodiscard]] Point At(double s) const {
    const auto next = std::upper_bound(at_.begin() + 1, at_.end() - 1, s);
    const auto i = static_cast<std::size_t>(next - at_.begin());
    const double segment = at_[i] - at_[i - 1];
    const double share = segment > 0.0 ? std::clamp((s - at_[i - 1]) / segment, 0.0, 1.0) : 1.0;
    return points_[i - 1] + share * (points_[i] - points_[i - 1]);
  }
  // Returns the position on the route nearest to p, not before `from` and not far after it.
  [[nodiscard]] double Progress(const Point& p, double from) const {
    constexpr int kPlaces = 20;
    constexpr double kSpacing = 0.02;
    double best = from;
    double least = Norm(At(from) - p);
    for (int i = 1; i <= kPlaces; ++i) {
      const double s = std::min(from + i * kSpacing, length());
      const double distance = Norm(At(s) - p);
      if (distance < least) {
        least = distance;
        best = s;
      }
    }
    return best;
  }

 private:
  std::vector<Point> points_;
  std::vector<double> at_;
};

// A tight tolerance: all machines must find the same solution to all printed digits.
constexpr double kTolerance = 1e-10;

safety::TaskOptions Options() {
  safety::TaskOptions options;
  options.guided.svm.tolerance = kTolerance;
  // With a wider kernel the published support reaches across the pillar; with a narrower kernel
  // DFR only halts.
  options.published = kernel::TimeVaryingSupportOptions();
  options.published->svm.gamma = 2.0;
  options.published->svm.tolerance = kTolerance;
  options.horizon = kHorizon;
  return options;
}

// Features of the certified method. Both coordinates have one unit, and |dz| is therefore a
// multiple of |dx|.
core::FeatureTransform OneUnit(std::span<const core::Trajectory> demonstrations) {
  const core::FeatureSelection all = core::FeatureSelection::All(2);
  std::vector<core::Matrix> states;
  states.reserve(demonstrations.size());
  for (const core::Trajectory& d : demonstrations) states.push_back(d.states);
  const core::FeatureTransform whitening =
      core::FeatureTransform::Whitening(all, states, {.decorrelate = false, .local = false});
  const double scale = 2.0 / whitening.scale().diagonal().cwiseInverse().sum();
  return {all, Eigen::VectorXd::Zero(2), scale * core::Matrix::Identity(2, 2)};
}

safety::TaskOptions CertifiedOptions(std::span<const core::Trajectory> demonstrations) {
  safety::TaskOptions options;
  options.guided.svm.gamma = 0.35;
  options.guided.svm.tolerance = kTolerance;
  options.guided.phase_whitening = false;
  options.features = OneUnit(demonstrations);
  return options;
}

}  // namespace

void PushedPolicy::Control(int t, std::span<const double> x, std::span<double> u) const noexcept {
  learned_->Control(t, x, u);
  for (std::size_t i = 0; i < 2; ++i) u[i] = std::clamp(u[i] + push_[i], -1.0, 1.0);
}

const std::vector<std::string>& MethodNames() {
  static const std::vector<std::string> names = {"baseline", "early-stopping", "dfr", "controller",
                                                 "certified-direction"};
  return names;
}

Support SupportOf(std::size_t method) noexcept {
  if (method < 3) return Support::kPublished;
  return method == 3 ? Support::kGuided : Support::kCertified;
}

Episode::Episode(const Scene& scene, const PushedPolicy& policy,
                 std::unique_ptr<control::Controller> controller, std::uint64_t seed)
    : plant_(scene), policy_(&policy), controller_(std::move(controller)) {
  controller_->Reset(seed);
}

bool Episode::over() const noexcept {
  return plant_.collided() || plant_.completed() || cause_ != control::HaltCause::kNone;
}

core::Outcome Episode::outcome() const noexcept {
  if (plant_.collided()) return core::Outcome::kCollided;
  return plant_.completed() ? core::Outcome::kCompleted : core::Outcome::kHalted;
}

Decision Episode::Step() noexcept {
  Decision decision;
  decision.from = decision.to = decision.wanted = plant_.point();
  if (over()) return decision;
  if (controls_++ == kMostControls) controller_->Stop(control::HaltCause::kControlLimit);
  Point control{};
  policy_->Control(t_, decision.from, control);
  decision.wanted = decision.from + Displacement(control);
  decision.step = controller_->Next(decision.from, control);
  t_ = decision.step.t + 1;
  if (decision.step.mode == control::Mode::kHalt) {
    cause_ = decision.step.cause;
    return decision;
  }
  if (plant_.Apply(control) != core::PlantStatus::kOk) cause_ = control::HaltCause::kPlantRefused;
  decision.to = plant_.point();
  return decision;
}

namespace {

// Data of the certified method.
struct CertifiedModel {
  CertifiedModel(const core::StateLayout& layout, std::span<const core::Trajectory> demonstrations)
      : model(layout, demonstrations, CertifiedOptions(demonstrations)),
        direction_error(control::EstimateDirectionError(model.features(), demonstrations).value),
        scale(model.features().scale()(0, 0)) {}

  safety::TaskModel model;
  double direction_error;
  double scale;  ///< Factor from state to features.
};

}  // namespace

struct World::Learned {
  Learned(const PointPlant& plant, int degree, std::span<const core::Trajectory> demonstrations)
      : polynomial(demonstrations, degree),
        policy(polynomial),
        unpushed(polynomial),
        model(plant.layout(), demonstrations, Options()) {}

  study::planar::PolynomialPolicy polynomial;
  PushedPolicy policy;
  PushedPolicy unpushed;  ///< Policy of Run(), without the user's pushes.
  safety::TaskModel model;
  std::optional<CertifiedModel> certified;

  [[nodiscard]] std::unique_ptr<control::Controller> Make(std::size_t method,
                                                          const PushedPolicy& with,
                                                          int first_step) const {
    const std::string& name = MethodNames().at(method);
    if (planar_page::SupportOf(method) != Support::kCertified) {
      return model.MakeController(safety::ParseMethod(name), with, {.first_step = first_step});
    }
    return std::make_unique<control::CertifiedController>(
        with, certified->model.view(),
        control::CertifiedOptions{
            .horizon = kHorizon,
            .first_step = first_step,
            .certificate = {.direction_error = certified->direction_error + 1e-9}});
  }
};

World::World(std::size_t scene) : scene_(&Scenes().at(scene)), plant_(*scene_) {}

World::~World() = default;

void World::Demonstrate(int count, std::uint64_t seed) {
  DFR_THROW_UNLESS(!scene_->routes.empty(), "This scene has no demonstrator: draw a line.");
  for (int i = 0; i < count; ++i) {
    const auto& route = scene_->routes[static_cast<std::size_t>(i) % scene_->routes.size()];
    for (std::uint64_t attempt = 0;; ++attempt) {
      DFR_THROW_UNLESS(attempt < 1000, "The demonstrator of this scene rarely succeeds.");
      auto demonstration =
          Follow(route, true, core::DeriveSeed(seed, {static_cast<std::uint64_t>(i), attempt}));
      if (!demonstration) continue;
      demonstrations_.push_back(*std::move(demonstration));
      break;
    }
  }
  learned_.reset();
}

void World::Draw(std::span<const Point> line, int repeats, std::uint64_t seed) {
  constexpr double kReach = 0.3;
  const Disc& start = scene_->start;
  const Disc& goal = scene_->goal;
  DFR_THROW_UNLESS(line.size() >= 2, "Draw a line from the start to the goal.");
  DFR_THROW_UNLESS(Norm(line.front() - start.centre) <= start.radius + kReach,
                   "Begin the line at the start.");
  DFR_THROW_UNLESS(Norm(line.back() - goal.centre) <= goal.radius + kReach,
                   "End the line at the goal.");
  std::vector<Point> route = {start.centre};
  for (const Point& p : line) {
    DFR_THROW_UNLESS(std::isfinite(p[0]) && std::isfinite(p[1]), "The line is not finite.");
    if (Norm(p - start.centre) > start.radius && Norm(p - goal.centre) > goal.radius &&
        Norm(p - route.back()) > 0.01) {
      route.push_back(p);
    }
  }
  route.push_back(goal.centre);
  std::vector<core::Trajectory> drawn;
  std::optional<core::Trajectory> exact = Follow(route, false, 0);
  DFR_THROW_UNLESS(exact, "The line touches an obstacle: draw one that does not.");
  drawn.push_back(*std::move(exact));
  const int most = 50 * repeats;
  for (int attempt = 0; attempt < most && static_cast<int>(drawn.size()) <= repeats; ++attempt) {
    auto demonstration =
        Follow(route, true, core::DeriveSeed(seed, {static_cast<std::uint64_t>(attempt)}));
    if (demonstration) drawn.push_back(*std::move(demonstration));
  }
  std::move(drawn.begin(), drawn.end(), std::back_inserter(demonstrations_));
  learned_.reset();
}

void World::Clear() {
  demonstrations_.clear();
  learned_.reset();
}

void World::Fit() { learned_ = std::make_unique<Learned>(plant_, scene_->degree, demonstrations_); }

void World::FitCertified() {
  if (!fitted_certified()) learned_->certified.emplace(plant_.layout(), demonstrations_);
}

bool World::fitted_certified() const noexcept {
  return fitted() && learned_->certified.has_value();
}

// Returns nothing if the path touches an obstacle or does not reach the goal.
std::optional<core::Trajectory> World::Follow(const std::vector<Point>& points, bool unsteady,
                                              std::uint64_t seed) const {
  core::Random random(core::DeriveSeed(seed, {1}));
  const Route route(points);
  const double noise = unsteady ? kUnsteady : 0.0;
  const Point aside{0.0, unsteady ? scene_->wander * random.Normal() : 0.0};
  PointPlant plant(*scene_);
  plant.Reset(seed);
  if (!unsteady) plant.MoveTo(points.front());
  double s = 0.0;
  core::Trajectory demonstration = core::Record(
      plant, kHorizon, [&](int /*t*/, std::span<const double> /*x*/, std::span<double> u) {
        s = route.Progress(plant.point() - aside, s);
        const Point aim = route.At(s + 2.0 * kSpeed * PointPlant::kGain) +
                          (s + 0.3 < route.length() ? aside : Point{});
        const Point way = aim - plant.point();
        Point control = ControlFor((kSpeed * PointPlant::kGain / std::max(1e-9, Norm(way))) * way);
        for (double& entry : control) entry += noise * random.Normal();
        control = Saturated(control);
        std::copy(control.begin(), control.end(), u.begin());
        return plant.Apply(u);
      });
  demonstration.seed = seed;
  if (demonstration.outcome != core::Outcome::kCompleted) return std::nullopt;
  return demonstration;
}

const core::LogDecisionFunction& World::Chosen(Support support) const noexcept {
  if (support == Support::kPublished) return *learned_->model.published();
  return support == Support::kGuided ? learned_->model.guided_support()
                                     : learned_->certified->model.feature_support();
}

int World::num_steps(Support support) const noexcept { return Chosen(support).num_steps(); }

double World::LogDecision(Support support, int t, const Point& x) const noexcept {
  const double scale = support == Support::kCertified ? learned_->certified->scale : 1.0;
  return Chosen(support).LogDecision(t, scale * x, {});
}

double World::Decision(Support support, int t, const Point& x) const noexcept {
  const double scale = support == Support::kCertified ? learned_->certified->scale : 1.0;
  return Chosen(support).Decision(t, scale * x);
}

int World::NearestStep(Support support, const Point& x) const noexcept {
  int best = 0;
  double most = -std::numeric_limits<double>::infinity();
  const int steps = std::min(num_steps(support), kHorizon);
  for (int t = 0; t < steps; ++t) {
    const double l = LogDecision(support, t, x);
    if (l > most) {
      most = l;
      best = t;
    }
  }
  return best;
}

SafeRegion World::Certified(int t, const Point& x) const noexcept {
  const core::LogDecisionFunction& support = Chosen(Support::kCertified);
  const double scale = learned_->certified->scale;
  const Point z = scale * x;
  Point shift{};
  const control::SafeBall ball = control::ComputeSafeBall(support, t, z, shift);
  return {.centre = x + (1.0 / scale) * shift, .radius = ball.radius / scale};
}

Episode World::Start(std::size_t method, const Point& start, int first_step,
                     std::uint64_t seed) const {
  Episode episode(*scene_, learned_->policy, learned_->Make(method, learned_->policy, first_step),
                  seed);
  episode.plant().MoveTo(start);
  return episode;
}

void World::Push(const Point& displacement) noexcept {
  learned_->policy.set_push(ControlFor(displacement));
}

Tally World::Run(std::size_t method, int count, std::uint64_t seed) const {
  Tally tally;
  for (int i = 0; i < count; ++i) {
    const auto number = static_cast<std::uint64_t>(i);
    Episode episode(*scene_, learned_->unpushed, learned_->Make(method, learned_->unpushed, 0),
                    core::DeriveSeed(seed, {number, 1}));
    episode.plant().Reset(core::DeriveSeed(seed, {number, 0}));
    while (!episode.over()) static_cast<void>(episode.Step());
    tally.completed += episode.outcome() == core::Outcome::kCompleted ? 1 : 0;
    tally.halted += episode.outcome() == core::Outcome::kHalted ? 1 : 0;
    tally.collided += episode.outcome() == core::Outcome::kCollided ? 1 : 0;
  }
  return tally;
}

}  // namespace dfr::apps::planar_page
