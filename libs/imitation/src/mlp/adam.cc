#include "mlp/adam.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

namespace dfr::imitation::internal {
namespace {
constexpr double kBeta1 = 0.9;
constexpr double kBeta2 = 0.999;
constexpr double kEpsilon = 1e-8;
}  // namespace

Adam::Adam(Eigen::Index parameters, double learning_rate)
    : learning_rate_(learning_rate),
      first_(Eigen::VectorXd::Zero(parameters)),
      second_(Eigen::VectorXd::Zero(parameters)) {}

void Adam::Step(const Eigen::VectorXd& gradient, Eigen::VectorXd& parameters) noexcept {
  ++steps_;
  const auto t = static_cast<double>(steps_);
  const double correction = 1.0 / std::sqrt(1.0 - std::pow(kBeta2, t));
  const double rate = learning_rate_ / (1.0 - std::pow(kBeta1, t));
  first_ = kBeta1 * first_ + (1.0 - kBeta1) * gradient;
  second_ = kBeta2 * second_ + (1.0 - kBeta2) * gradient.cwiseAbs2();
  parameters.array() -= rate * first_.array() / (correction * second_.array().sqrt() + kEpsilon);
}

void Adam::Save(core::ArchiveWriter& archive) const {
  archive.Integer(steps_);
  archive.Numbers(core::AsSpan(first_));
  archive.Numbers(core::AsSpan(second_));
}

void Adam::Load(core::ArchiveReader& archive) {
  steps_ = archive.Integer();
  const std::vector<double> first = archive.Numbers();
  const std::vector<double> second = archive.Numbers();
  if (core::AsVector(first).size() != first_.size() ||
      core::AsVector(second).size() != second_.size()) {
    archive.Fail("the optimiser's moments do not belong to a network of this size");
  }
  if (!core::AllFinite(first) || !core::AllFinite(second)) {
    archive.Fail("the optimiser's moments are not finite");
  }
  if (std::ranges::any_of(second, [](double v) { return v < 0.0; })) {
    archive.Fail("an optimiser's second moment is negative");
  }
  if (steps_ < 0) {
    archive.Fail("the optimiser's number of steps is " + std::to_string(steps_));
  }
  first_ = core::AsVector(first);
  second_ = core::AsVector(second);
}

}  // namespace dfr::imitation::internal
