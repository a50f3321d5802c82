#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>

#include "dfr/sim/pusher/pusher_plant.h"

namespace dfr::sim {

/// A fixed camera of the scene.
enum class PusherCamera {
  kAngled,    ///< View from beside the goal, above the table.
  kOverhead,  ///< View straight down with the goal at the top and translucent arm links.
};

/// Options for PusherRenderer. Sizes are in pixels.
struct PusherRendererOptions {
  int width = 640;   ///< In [16, 1920].
  int height = 480;  ///< In [16, 1080].
  PusherCamera camera = PusherCamera::kAngled;
};

/// Draws a Pusher without a display, in software by OSMesa or through EGL. Uses EGL if OSMesa fails
/// or the environment variable DFR_GL is egl; the first choice applies to the whole process. A
/// picture takes about 0.1 s in software. Each object belongs to the thread that made it, which
/// must not have another OpenGL context.
class PusherRenderer {
 public:
  /// @param plant  provides the model; any plant with the same options can be drawn.
  /// @throws std::invalid_argument for a size out of range; std::runtime_error if neither OSMesa
  ///   nor EGL works on this machine, with the message of each.
  explicit PusherRenderer(const PusherPlant& plant, const PusherRendererOptions& options = {});
  ~PusherRenderer();
  PusherRenderer(PusherRenderer&&) noexcept;
  PusherRenderer& operator=(PusherRenderer&&) noexcept;

  /// Writes the plant's current state as height x width RGB bytes, top row first.
  /// @pre rgb.size() == 3 * width * height
  void Draw(const PusherPlant& plant, std::span<std::uint8_t> rgb);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::sim
