#pragma once

#include <span>
#include <utility>

#include "dfr/control/guided/task_view.h"
#include "dfr/core/trajectory.h"

namespace dfr::test {

/// Owns the parts of a task that controllers borrow. The caller owns the support.
struct Task {
  Task(core::FeatureTransform transform, const core::LogDecisionFunction& inner,
       std::span<const core::Trajectory> demonstrations, const control::LevelOptions& options = {})
      : features(std::move(transform)),
        support(inner),
        seen(features, demonstrations),
        levels(support, seen.points, options),
        response(seen) {}

  [[nodiscard]] control::TaskView view() const { return {features, support, levels, response}; }
  // Converts to a view. NOLINTNEXTLINE(google-explicit-constructor)
  operator control::TaskView() const { return view(); }

  core::FeatureTransform features;
  const core::LogDecisionFunction& support;
  control::FeatureTrajectories seen;
  control::Levels levels;
  control::Response response;
};

}  // namespace dfr::test
