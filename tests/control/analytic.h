#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "dfr/core/decision_function.h"
#include "dfr/core/plant.h"
#include "dfr/core/policy.h"
#include "dfr/core/random.h"

/// Supports, policies and plants whose behaviour can be computed by hand.
namespace dfr::test {

inline double Norm(std::span<const double> v) {
  double square = 0.0;
  for (const double entry : v) square += entry * entry;
  return std::sqrt(square);
}

/// A decision function g_t(x) given as a callable. Counts its evaluations.
class FunctionSupport : public core::DecisionFunction {
 public:
  using Function = std::function<double(int, std::span<const double>)>;
  FunctionSupport(int dim, Function function) : dim_(dim), function_(std::move(function)) {}
  int state_dim() const noexcept override { return dim_; }
  int num_steps() const noexcept override { return 1; }
  double Decision(int t, std::span<const double> x) const noexcept override {
    ++calls;
    return function_(t, x);
  }
  double Gradient(int t, std::span<const double> x, std::span<double> g) const noexcept override {
    std::fill(g.begin(), g.end(), 0.0);
    return Decision(t, x);
  }
  mutable int calls = 0;

 private:
  int dim_;
  Function function_;
};

/// g(x) = 1 - |x|: the unit ball, 1-Lipschitz, the same at all times.
inline FunctionSupport UnitBall(int dim) {
  return {dim, [](int, std::span<const double> x) { return 1.0 - Norm(x); }};
}

/// l_t(x) for states of one entry, given as a callable that fills a non-empty gradient. g = l.
class FunctionLogSupport : public core::LogDecisionFunction {
 public:
  using Function = std::function<double(int, std::span<const double>, std::span<double>)>;
  FunctionLogSupport(int steps, double curvature, Function function)
      : steps_(steps), curvature_(curvature), function_(std::move(function)) {}
  int state_dim() const noexcept override { return 1; }
  int num_steps() const noexcept override { return steps_; }
  double Decision(int t, std::span<const double> x) const noexcept override {
    return function_(t, x, {});
  }
  double Gradient(int t, std::span<const double> x, std::span<double> g) const noexcept override {
    return function_(t, x, g);
  }
  double LogDecision(int t, std::span<const double> x,
                     std::span<double> g) const noexcept override {
    return function_(t, x, g);
  }
  double FromLog(int, double l) const noexcept override { return l; }
  double curvature_bound(int) const noexcept override { return curvature_; }

 private:
  int steps_;
  double curvature_;
  Function function_;
};

/// g = value everywhere.
inline FunctionSupport ConstantSupport(int dim, double value) {
  return {dim, [value](int, std::span<const double>) { return value; }};
}

/// l_t(x) = log(sum_i exp(-gamma |x - c_i - t drift|^2) / k) - log rho with k equal Gaussians, term
/// by term from the definition. B_t moves with t. g_t(x) = rho (exp(l_t(x)) - 1).
class GaussianSupport : public core::LogDecisionFunction {
 public:
  GaussianSupport(std::vector<std::vector<double>> centres, double gamma, double rho,
                  std::vector<double> drift = {}, int steps = 1)
      : centres_(std::move(centres)),
        gamma_(gamma),
        rho_(rho),
        drift_(std::move(drift)),
        steps_(steps) {
    if (drift_.empty()) drift_.assign(centres_[0].size(), 0.0);
  }
  int state_dim() const noexcept override { return static_cast<int>(centres_[0].size()); }
  int num_steps() const noexcept override { return steps_; }
  double LogDecision(int t, std::span<const double> x,
                     std::span<double> gradient) const noexcept override {
    const double time = std::clamp(t, 0, steps_ - 1);
    std::fill(gradient.begin(), gradient.end(), 0.0);
    double sum = 0.0;
    for (const auto& c : centres_) {
      double square = 0.0;
      for (std::size_t i = 0; i < x.size(); ++i) {
        square += (x[i] - c[i] - time * drift_[i]) * (x[i] - c[i] - time * drift_[i]);
      }
      const double term = std::exp(-gamma_ * square) / static_cast<double>(centres_.size());
      sum += term;
      for (std::size_t i = 0; i < gradient.size(); ++i) {
        gradient[i] += 2.0 * gamma_ * term * (c[i] + time * drift_[i] - x[i]);
      }
    }
    for (double& g : gradient) g /= sum;
    return std::log(sum) - std::log(rho_);
  }
  double FromLog(int, double l) const noexcept override { return rho_ * std::expm1(l); }
  double curvature_bound(int) const noexcept override { return gamma_; }
  double Decision(int t, std::span<const double> x) const noexcept override {
    return rho_ * (std::exp(LogDecision(t, x, {})) - 1.0);
  }
  double Gradient(int t, std::span<const double> x, std::span<double> g) const noexcept override {
    const double l = LogDecision(t, x, g);
    for (double& entry : g) entry *= rho_ * std::exp(l);
    return rho_ * (std::exp(l) - 1.0);
  }
  double lipschitz_bound() const noexcept { return std::sqrt(2.0 * gamma_ / 2.718281828459045); }

 private:
  std::vector<std::vector<double>> centres_;
  double gamma_;
  double rho_;
  std::vector<double> drift_;
  int steps_;
};

/// A policy u = pi(t, x) given as a callable.
class FunctionPolicy : public core::Policy {
 public:
  using Function = std::function<void(int, std::span<const double>, std::span<double>)>;
  FunctionPolicy(int state_dim, int control_dim, Function function)
      : state_dim_(state_dim), control_dim_(control_dim), function_(std::move(function)) {}
  int state_dim() const noexcept override { return state_dim_; }
  int control_dim() const noexcept override { return control_dim_; }
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override {
    function_(t, x, u);
  }

 private:
  int state_dim_;
  int control_dim_;
  Function function_;
};

/// u_0 = value, other entries zero.
inline FunctionPolicy ConstantPolicy(int dim, double value) {
  return {dim, dim, [value](int, std::span<const double>, std::span<double> u) {
            std::fill(u.begin(), u.end(), 0.0);
            u[0] = value;
          }};
}

/// Moves away from the origin at `speed`.
inline FunctionPolicy OutwardPolicy(int dim, double speed) {
  return {dim, dim, [speed](int, std::span<const double> x, std::span<double> u) {
            const double norm = Norm(x);
            for (std::size_t i = 0; i < u.size(); ++i) u[i] = norm > 0 ? speed * x[i] / norm : 0;
            if (norm == 0) u[0] = speed;
          }};
}

/// A point, x' = x + gain R u, with R the identity or a new random rotation of the first two
/// coordinates at each step. In both cases |x' - x| = gain |u|.
struct PointPlantOptions {
  std::vector<double> start = {0.0, 0.0};
  double gain = 1.0;
  bool turns = false;
  double wall = std::numeric_limits<double>::infinity();  ///< Collides at |x| > wall.
  double goal = std::numeric_limits<double>::infinity();  ///< Completed at x_0 >= goal.
  int refuse_at = -1;                                     ///< Index of a control that is rejected.
  int fault_at = -1;  ///< Index of a control that is applied and reported as a fault.
};

class PointPlant final : public core::SimulatedPlant {
 public:
  explicit PointPlant(PointPlantOptions options) : options_(std::move(options)), x(options_.start) {
    layout_.Add("point", static_cast<int>(x.size()));
  }
  const core::StateLayout& layout() const noexcept override { return layout_; }
  int control_dim() const noexcept override { return static_cast<int>(x.size()); }
  void Reset(std::uint64_t seed) override {
    x = options_.start;
    random_ = core::Random(seed);
    collided_ = false;
    applied = 0;
    halts = 0;
    Look();
  }
  core::PlantStatus Apply(std::span<const double> u) noexcept override {
    if (applied == options_.refuse_at) return core::PlantStatus::kRefused;
    double cosine = 1.0;
    double sine = 0.0;
    if (options_.turns) {
      const double angle = random_.Uniform(-3.15, 3.15);
      cosine = std::cos(angle);
      sine = std::sin(angle);
    }
    for (std::size_t i = 2; i < x.size(); ++i) x[i] += options_.gain * u[i];
    if (x.size() == 1) {
      x[0] += options_.gain * u[0];
    } else {
      x[0] += options_.gain * (cosine * u[0] - sine * u[1]);
      x[1] += options_.gain * (sine * u[0] + cosine * u[1]);
    }
    Look();
    const bool fault = applied == options_.fault_at;
    ++applied;
    return fault ? core::PlantStatus::kFault : core::PlantStatus::kOk;
  }
  void Observe(std::span<double> state) const noexcept override {
    std::copy(x.begin(), x.end(), state.begin());
  }
  bool completed() const noexcept override { return x[0] >= options_.goal; }
  bool collided() const noexcept override { return collided_; }
  void Halt() noexcept override { ++halts; }
  std::unique_ptr<core::SimulatedPlant> Clone() const override {
    return std::make_unique<PointPlant>(*this);
  }
  void CopyStateFrom(const core::SimulatedPlant& other) noexcept override {
    const auto& o = static_cast<const PointPlant&>(other);
    std::copy(o.x.begin(), o.x.end(), x.begin());
    random_ = o.random_;
    collided_ = o.collided_;
    applied = o.applied;
  }

 private:
  void Look() noexcept { collided_ = collided_ || Norm(x) > options_.wall; }

  PointPlantOptions options_;
  core::StateLayout layout_;
  core::Random random_{0};
  bool collided_ = false;

 public:
  std::vector<double> x;
  int applied = 0;
  int halts = 0;
};

}  // namespace dfr::test
