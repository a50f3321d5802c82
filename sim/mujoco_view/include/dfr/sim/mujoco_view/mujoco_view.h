#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>

// MuJoCo's own types, declared by name only: callers pass references.
struct mjModel_;
struct mjData_;
struct mjvScene_;

namespace dfr::sim {

/// Options for MujocoRenderer. Sizes are in pixels.
struct MujocoRendererOptions {
  int width = 640;          ///< Width, in [16, 1920], and at most the model's offwidth.
  int height = 480;         ///< Height, in [16, 1080], and at most the model's offheight.
  std::string camera = {};  ///< Name of a fixed camera of the model.
  /// Draws shadows, reflections, haze and sky. They dominate the drawing time of software OpenGL.
  bool effects = true;
  /// Changes the scene before it is drawn, for example to fade obstructing parts. May be empty.
  std::function<void(mjvScene_&)> decorate = {};
};

/// Draws a MuJoCo model without a display, in software by OSMesa or through EGL. Uses EGL if OSMesa
/// fails or the environment variable DFR_GL is egl; the first choice applies to the whole process.
///
/// Each object belongs to the thread that made it; a thread may have several. Borrows the model.
class MujocoRenderer {
 public:
  /// @throws std::invalid_argument for a size out of range or a camera not in the model;
  ///   std::runtime_error if rendering is not possible on this machine, with the messages of OSMesa
  ///   and EGL.
  MujocoRenderer(const mjModel_& model, const MujocoRendererOptions& options);
  ~MujocoRenderer();
  MujocoRenderer(MujocoRenderer&&) noexcept;
  MujocoRenderer& operator=(MujocoRenderer&&) noexcept;

  /// Writes the camera's view at the positions of `data` as height x width RGB bytes, top row
  /// first.
  /// @pre rgb.size() == 3 * width * height
  void Draw(const mjData_& data, std::span<std::uint8_t> rgb);
  /// Same as Draw(), but in OpenGL's order: bottom row first. Avoids a copy.
  void DrawBottomUp(const mjData_& data, std::span<std::uint8_t> rgb);

  /// Uploads the current pixels of a texture of the model.
  void UploadTexture(int texture);
  /// Sets whether geoms of `group` (0 to 5) are drawn. Initially groups 0 to 2 are drawn.
  void ShowGroup(int group, bool visible);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::sim
