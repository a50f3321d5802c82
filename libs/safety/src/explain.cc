#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "dfr/control/phase_tracker.h"
#include "dfr/core/contract.h"
#include "dfr/core/features/absolute_actions.h"
#include "dfr/core/features/rotations.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/text/format.h"
#include "dfr/safety/guard_advice.h"

namespace dfr::safety {
namespace {

using control::HaltCause;

// Path of steepest ascent to l = 0 in features: the contribution of each feature to the rise of l,
// and the displacement in the units of the state.
class WayBack {
 public:
  explicit WayBack(const GuardModel& model, bool with_products = false)
      : features_(&model.task().features()),
        support_(&model.task().feature_support()),
        scale_(features_->scale()),
        inverse_(core::PseudoInverse(scale_)) {
    if (with_products) products_.resize(scale_.cols(), scale_.cols());
  }

  /// Starts at features z at time step t, where l = -`missing` < 0.
  void Go(int t, Eigen::VectorXd z, double missing) {
    constexpr int kSteps = 64;
    share_ = Eigen::VectorXd::Zero(z.size());
    way_ = share_;
    products_.setZero();
    Eigen::VectorXd before(z.size());
    Eigen::VectorXd slope(z.size());
    double l = support_->LogDecision(t, core::AsSpan(z), core::AsSpan(before));
    for (int step = 0; step < kSteps && l < 0.0; ++step) {
      const double steepness = before.squaredNorm();
      if (!(steepness > 0.0)) break;  // There is no direction of ascent.
      // Each step gains the same fraction of the missing level.
      const Eigen::VectorXd up = (-l / (kSteps - step) / steepness) * before;
      z += up;
      l = support_->LogDecision(t, core::AsSpan(z), core::AsSpan(slope));
      const Eigen::VectorXd along = inverse_ * up;
      const Eigen::VectorXd gradient = 0.5 * scale_.transpose() * (before + slope);
      share_ += gradient.cwiseProduct(along);
      if (products_.size() > 0) products_ += gradient * along.transpose();
      way_ += along;
      before = slope;
    }
    // The sum of the trapezoids differs from the rise of l only by the integration error.
    if (!(share_.sum() > 0.0)) return;
    products_ *= missing / share_.sum();
    share_ *= missing / share_.sum();
  }
  /// Returns the selected entries of a state with features z.
  [[nodiscard]] Eigen::VectorXd Selected(const Eigen::VectorXd& z) const {
    return inverse_ * z + features_->offset();
  }
  [[nodiscard]] const Eigen::VectorXd& share() const { return share_; }
  [[nodiscard]] const Eigen::VectorXd& way() const { return way_; }
  /// Sum of gradient times step', whose diagonal is share(); empty without `with_products`.
  [[nodiscard]] const Eigen::MatrixXd& products() const { return products_; }

 private:
  const core::FeatureTransform* features_;
  const kernel::WhitenedSupport* support_;
  Eigen::MatrixXd scale_;
  Eigen::MatrixXd inverse_;
  Eigen::VectorXd share_;
  Eigen::VectorXd way_;
  Eigen::MatrixXd products_;
};

std::vector<OutsideEntry> EntriesAt(const GuardModel& model, int t, const Eigen::VectorXd& z) {
  std::vector<OutsideEntry> found;
  const double l = model.task().feature_support().LogDecision(t, core::AsSpan(z), {});
  if (!(l < 0.0 && std::isfinite(l))) return found;
  WayBack back(model);
  back.Go(t, z, -l);
  const std::vector<int>& entries = model.task().features().selection().indices();
  const core::FeatureTransform& features = model.task().features();
  for (std::size_t k = 0; k < entries.size(); ++k) {
    const auto i = static_cast<Eigen::Index>(k);
    OutsideEntry& entry = found.emplace_back(
        OutsideEntry{.entry = entries[k], .share = back.share()[i], .excess = -back.way()[i]});
    if (features.selection().map().FindCircle(entries[k]) == nullptr) continue;
    // Projects the displacement of the point onto the circle of the angle.
    const Eigen::Vector2d point = back.Selected(z).segment<2>(i);
    const Eigen::Vector2d way = back.way().segment<2>(i);
    entry.share += back.share()[i + 1];
    entry.excess = (point[1] * way[0] - point[0] * way[1]) / point.norm();
    ++k;
  }
  std::stable_sort(found.begin(), found.end(),
                   [](const OutsideEntry& a, const OutsideEntry& b) { return a.share > b.share; });
  return found;
}

// Predicts the features after `action` from demonstrations.
Eigen::VectorXd Predicted(const GuardModel& model, int t, Eigen::VectorXd z,
                          std::span<const double> action) {
  const control::Response& response = model.task().response();
  const control::LocalFit answer =
      control::ResponseEstimate(response.prior(), {}, response.has_drift())
          .FitAt(t, core::AsSpan(z));
  Eigen::VectorXd v(model.actions().steered_dim());
  model.actions().Measure(action, core::AsSpan(v));
  v /= response.control_unit();
  answer.AddEffect(v, z);
  return z;
}

std::optional<std::size_t> FirstNotFinite(std::span<const double> values) {
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (!std::isfinite(values[i])) return i;
  }
  return std::nullopt;
}

// Describes the first invalid value of the state or the action; "" if there is none.
std::string WrongInput(const GuardModel& model, std::span<const double> state,
                       std::span<const double> action) {
  if (static_cast<int>(state.size()) != model.state_dim()) {
    return core::Format("the state has %zu entries; the guard needs %d", state.size(),
                        model.state_dim());
  }
  if (const auto i = FirstNotFinite(state)) {
    return core::EntryName(model.layout(), static_cast<Eigen::Index>(*i)) +
           core::Format(" of the state is %g", state[*i]);
  }
  if (model.reduction() != nullptr) {
    if (std::string fault = model.reduction()->Fault(state); !fault.empty()) return fault;
  }
  const core::Matrix row = core::AsVector(state).transpose();
  const core::Matrix seen = model.TaskStates(row);
  std::vector<double> values(static_cast<std::size_t>(model.num_constants()));
  const std::span<const double> task_state = core::Row(seen, 0);
  if (const int entry = model.FindImmeasurableAngle(task_state); entry >= 0) {
    return core::EntryName(model.task_layout(), entry) +
           core::Format(" of the state is %.4g, more than a million revolutions from zero",
                        task_state[static_cast<std::size_t>(entry)]);
  }
  if (const int entry = model.FindChangedConstant(task_state, values); entry >= 0) {
    return core::EntryName(model.task_layout(), entry) +
           core::Format(" of the state is %.4g, unlike in all demonstrations, where it is constant",
                        task_state[static_cast<std::size_t>(entry)]);
  }
  if (static_cast<int>(action.size()) != model.action_dim()) {
    return core::Format("the action has %zu entries; the guard needs %d", action.size(),
                        model.action_dim());
  }
  if (const auto i = FirstNotFinite(action)) {
    return core::Format("entry %zu of the action is %g", *i, action[*i]);
  }
  return {};
}

// Describes the frozen sensor of a verdict.
std::string Standstill(const GuardModel& model, const Verdict& verdict) {
  const SensorGroup& group = model.sensor_groups()[static_cast<std::size_t>(verdict.frozen)];
  const core::StateLayout& layout = model.layout();
  constexpr int kMost = 4;
  std::string name;
  int parts = 0;
  for (const SensorGroup::Range& range : group.ranges) {
    for (const auto& block : layout.blocks) {
      const int first = std::max(range.first, block.offset);
      const int size = std::min(range.first + range.size, block.offset + block.size) - first;
      if (size <= 0 || ++parts > kMost) continue;
      name += parts == 1 ? "" : ", ";
      name += block.picture.height > 0 ? "the picture '" + block.name + "'"
              : size == 1              ? core::EntryName(layout, first)
                                       : core::EntryRange(layout, first, size);
    }
  }
  if (parts > kMost) name += core::Format(" and %d others", parts - kMost);
  return name + core::Format(
                    " has not changed for %.0f steps; in demonstrations it never "
                    "stood still for more than %.0f",
                    verdict.unchanged, group.longest);
}

const char* CauseOf(HaltCause cause) {
  switch (cause) {
    case HaltCause::kNotReset:
      return "reset was not called";
    case HaltCause::kTimeUp:
      return "the episode is longer than the horizon";
    case HaltCause::kIterationLimit:
      return "the episode has reached max_actions";
    case HaltCause::kStepSkipped:
      return "t was not the next one: a call was lost or doubled";
    case HaltCause::kStopRequested:
      return "the caller requested it";
    case HaltCause::kSupportInvalid:
      return "the state is immeasurably far outside";
    case HaltCause::kNoProgress:
      return "the last actions have made no progress or have led away from demonstrations";
    case HaltCause::kStateInvalid:
      return "an earlier state was invalid";
    case HaltCause::kControlInvalid:
      return "an earlier action was invalid";
    default:
      return control::Name(cause);
  }
}

// Describes an outcome that contradicts the certificate.
std::string Violation(double observed, double allowed) {
  if (std::isinf(observed)) {
    return "the features changed although the last action was zero, which contradicts the "
           "certificate";
  }
  return core::Format(
      "the effect of the last action differed from its prediction by %.3g per unit "
      "of action; the certificate allows %.3g",
      observed, allowed);
}

// Explains why the policy's action is not applied.
std::string WhyNot(const GuardModel& model, const Verdict& verdict, std::span<const double> state,
                   std::span<const double> action) {
  const std::vector<double>& limits = model.settings().action_limit;
  for (std::size_t i = 0; i < action.size(); ++i) {
    if (std::abs(action[i]) > limits[i]) {
      return core::Format("entry %zu of the action is %.3g, beyond its limit %.3g", i, action[i],
                          limits[i]);
    }
  }
  const Eigen::VectorXd z = model.Features(state);
  if (std::isfinite(verdict.predicted)) {
    const int next = verdict.step + 1;
    std::string text =
        core::Format("the policy's action is predicted to reach l = %.3g and passes from %.3g on",
                     verdict.predicted, verdict.pass_level);
    const auto entries = EntriesAt(model, next, Predicted(model, verdict.step, z, action));
    return entries.empty() ? text : text + ": then " + Describe(model, next, entries);
  }
  if (model.settings().strategy == Strategy::kCertified && verdict.source != Source::kHalt) {
    const Certification found = model.Certify(verdict.step, state, action);
    if (found.passes) {
      return core::Format(
          "the policy's action would raise no alarm, but is not predicted to reach l = %.3g, from "
          "which on it passes unchanged",
          verdict.pass_level);
    }
    return core::Format(
        "the policy's action is not certified to end without an alarm: l at step "
        "%d would be %.3g below the required level",
        found.step, -found.margin);
  }
  const auto entries = EntriesAt(model, verdict.alarm_step, z);
  if (!entries.empty()) return Describe(model, verdict.alarm_step, entries);
  return core::Format("g = %.3g, and an action of this size passes above %.3g", verdict.g,
                      verdict.threshold);
}

}  // namespace

core::Matrix Attribution(const GuardModel& model, const core::Matrix& states) {
  std::vector<int> steps;
  const std::vector<double> levels = model.Levels(states, &steps);
  const std::vector<int>& entries = model.task().features().selection().indices();
  const reduction::StateReduction* const reduction = model.reduction();
  WayBack back(model, reduction != nullptr);
  core::Matrix attribution = core::Matrix::Zero(states.rows(), states.cols());
  for (Eigen::Index i = 0; i < states.rows(); ++i) {
    const double missing = -levels[static_cast<std::size_t>(i)];
    if (missing <= 0.0) continue;
    if (!std::isfinite(missing)) {
      attribution.row(i).setConstant(std::numeric_limits<double>::quiet_NaN());
      continue;
    }
    back.Go(steps[static_cast<std::size_t>(i)], model.Features(core::Row(states, i)), missing);
    if (reduction != nullptr) {
      const auto dim = static_cast<Eigen::Index>(reduction->reduced_dim());
      Eigen::MatrixXd products = Eigen::MatrixXd::Zero(dim, dim);
      for (std::size_t k = 0; k < entries.size(); ++k) {
        for (std::size_t j = 0; j < entries.size(); ++j) {
          products(entries[k], entries[j]) +=
              back.products()(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(j));
        }
      }
      reduction->Spread(products, core::Row(states, i), core::Row(attribution, i));
      continue;
    }
    for (std::size_t k = 0; k < entries.size(); ++k) {
      attribution(i, entries[k]) += back.share()[static_cast<Eigen::Index>(k)];
    }
  }
  return attribution;
}

std::vector<OutsideEntry> OutsideEntries(const GuardModel& model, int t,
                                         std::span<const double> state) {
  return EntriesAt(model, t, model.Features(state));
}

std::string Describe(const GuardModel& model, int t, std::span<const OutsideEntry> entries) {
  constexpr std::size_t kMost = 2;
  constexpr double kLeastShare = 0.2;
  if (entries.empty()) return {};
  std::string text;
  for (std::size_t i = 0; i < std::min(kMost, entries.size()); ++i) {
    if (i > 0 && entries[i].share < kLeastShare * entries[0].share) break;
    text += (i == 0 ? "" : ", ") + core::EntryName(model.task_layout(), entries[i].entry) +
            (i == 0 ? " is " : " ") +
            core::Format("%.3g %s", std::abs(entries[i].excess),
                         entries[i].excess >= 0.0 ? "above" : "below");
  }
  return text +
         core::Format(" what was demonstrated at step %d", std::clamp(t, 0, model.num_steps() - 1));
}

NearestDemonstration Nearest(const GuardModel& model, int t, std::span<const double> state,
                             std::span<const core::Matrix> demonstrations) {
  const Eigen::VectorXd z = model.Features(state);
  NearestDemonstration nearest{.distance = std::numeric_limits<double>::infinity()};
  constexpr int kWindow = control::PhaseTracker::kWindow;
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    DFR_THROW_UNLESS(demonstrations[d].cols() == std::ssize(state),
                     "demonstration " << d << " has states of " << demonstrations[d].cols()
                                      << " entries, but the guard's states have " << state.size());
    for (Eigen::Index i = 0; i < demonstrations[d].rows(); ++i) {
      DFR_THROW_UNLESS(demonstrations[d].row(i).allFinite(),
                       "demonstration " << d << " has a non-finite entry in state " << i);
    }
    const auto rows = static_cast<int>(demonstrations[d].rows());
    const int near = std::min(t, rows - 1);
    const int first = t < 0 ? 0 : std::max(0, near - kWindow);
    const int last = t < 0 ? rows - 1 : std::min(rows - 1, near + kWindow);
    for (int i = first; i <= last; ++i) {
      const double distance = (model.Features(core::Row(demonstrations[d], i)) - z).norm();
      if (!(distance < nearest.distance)) continue;
      nearest = {.demonstration = static_cast<int>(d), .step = i, .distance = distance};
    }
  }
  return nearest;
}

std::string Explain(const GuardModel& model, const Verdict& verdict, std::span<const double> state,
                    std::span<const double> action) {
  switch (verdict.source) {
    case Source::kPolicy:
      return {};
    case Source::kHalt: {
      if (verdict.cause == HaltCause::kStateInvalid && verdict.frozen >= 0) {
        return "halted: " + Standstill(model, verdict);
      }
      if (verdict.cause == HaltCause::kViolated && !std::isnan(verdict.observed_error)) {
        return "halted: " + Violation(verdict.observed_error, model.settings().direction_error);
      }
      const bool invalid =
          verdict.cause == HaltCause::kStateInvalid || verdict.cause == HaltCause::kControlInvalid;
      const bool outside =
          verdict.cause == HaltCause::kOutsideSupport || verdict.cause == HaltCause::kEarlyStopping;
      const std::string wrong = invalid || outside ? WrongInput(model, state, action) : "";
      if (invalid && !wrong.empty()) return "halted: " + wrong;
      if (outside && wrong.empty()) return "halted: " + WhyNot(model, verdict, state, action);
      return std::string("halted: ") + CauseOf(verdict.cause);
    }
    case Source::kPolicyChanged:
      return "changed: " + WhyNot(model, verdict, state, action);
    case Source::kDemonstrations:
      return "replaced by a demonstrated action: " + WhyNot(model, verdict, state, action);
    case Source::kProbe:
      return "probed, to measure the effect of actions: " + WhyNot(model, verdict, state, action);
    case Source::kRecovery:
      return "replaced by a recovery: " + WhyNot(model, verdict, state, action);
  }
  return {};
}

}  // namespace dfr::safety
