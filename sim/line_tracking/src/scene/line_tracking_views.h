#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "dfr/sim/mujoco_view/mujoco_view.h"
#include "scene/line_tracking_scene.h"

namespace dfr::sim::internal {

/// Contents of the endoscope's view other than gauze and marks.
struct Contents {
  GauzeLine line;
  bool with_line = true;
  bool with_tool = true;
};

/// One camera of the scene and its copy of the gauze. Belongs to the thread that made it.
class SceneView {
 public:
  static constexpr int kWidth = 640;
  static constexpr int kHeight = 480;

  /// @param outside  draws all bodies from the outside camera instead of the endoscope's view.
  /// @throws std::runtime_error if rendering is not possible on this machine.
  SceneView(const SceneModel& scene, bool outside);

  /// Returns kWidth x kHeight RGB, bottom row first.
  [[nodiscard]] std::span<const std::uint8_t> Draw(const SceneData& data, const Contents& contents);

 private:
  const SceneModel* scene_;
  MjModelPtr model_;  // with the most recently drawn gauze
  MujocoRenderer renderer_;
  std::optional<Contents> drawn_;
  std::vector<std::uint8_t> rgb_;
};

}  // namespace dfr::sim::internal
