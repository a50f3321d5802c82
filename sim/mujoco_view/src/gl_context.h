#pragma once

#include <memory>
#include <string>

namespace dfr::sim::internal {

/// An OpenGL context, current on the thread that made it during its lifetime. All drawing on a
/// thread shares one context: a window's if there is a window, otherwise an off-screen one.
class GlContext {
 public:
  GlContext() = default;
  virtual ~GlContext() = default;
  GlContext(const GlContext&) = delete;
  GlContext& operator=(const GlContext&) = delete;

  /// Returns "OSMesa", "EGL" or "GLFW".
  [[nodiscard]] virtual const std::string& name() const noexcept = 0;

  /// Returns this thread's context. If there is none, creates one off screen: OSMesa, or EGL if
  /// OSMesa fails or DFR_GL=egl requests it.
  /// @throws std::runtime_error with the messages of OSMesa and EGL.
  static std::shared_ptr<GlContext> OfThisThread();

  /// Makes a window's context, which must be current, the context of this thread.
  /// @throws std::logic_error if the thread has one already.
  static void Adopt(const std::shared_ptr<GlContext>& window);
};

}  // namespace dfr::sim::internal
