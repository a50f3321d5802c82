#pragma once

#include <memory>
#include <string>

namespace dfr::sim::internal {

/// An OpenGL context, current on the thread that made it while it lives. All that draws on a thread
/// shares one: a window's if there is a window, else one off screen.
class GlContext {
 public:
  GlContext() = default;
  virtual ~GlContext() = default;
  GlContext(const GlContext&) = delete;
  GlContext& operator=(const GlContext&) = delete;

  /// "OSMesa", "EGL" or "GLFW".
  [[nodiscard]] virtual const std::string& name() const noexcept = 0;

  /// This thread's context. Where there is none, a new one off screen: OSMesa, or EGL where that
  /// fails or DFR_GL=egl asks for it.
  /// @throws std::runtime_error with what each said.
  static std::shared_ptr<GlContext> OfThisThread();

  /// Makes a window's context, current on this thread, the thread's own.
  /// @throws std::logic_error if the thread has one already.
  static void Adopt(const std::shared_ptr<GlContext>& window);
};

}  // namespace dfr::sim::internal
