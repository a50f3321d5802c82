#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "dfr/sim/mujoco_view/mujoco_view.h"
#include "line_tracking_scene.h"

namespace dfr::sim::internal {

/// What is in the endoscope's view besides gauze and marks.
struct Contents {
  GauzeLine line;
  bool with_line = true;
  bool with_tool = true;
};

/// One camera of the scene and the gauze that it sees, on the thread that made it.
class SceneView {
 public:
  static constexpr int kWidth = 640;
  static constexpr int kHeight = 480;

  /// @param outside  the outside view with all there is, instead of the endoscope's.
  /// @throws std::runtime_error if nothing can be drawn here.
  SceneView(const SceneModel& scene, bool outside);

  /// kWidth x kHeight RGB, bottom row first.
  [[nodiscard]] std::span<const std::uint8_t> Draw(const SceneData& data, const Contents& contents);

 private:
  const SceneModel* scene_;
  MjModelPtr model_;  // with the gauze as drawn last
  MujocoRenderer renderer_;
  std::optional<Contents> drawn_;
  std::vector<std::uint8_t> rgb_;
};

}  // namespace dfr::sim::internal
