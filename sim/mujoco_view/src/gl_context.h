#pragma once

#include <memory>
#include <string>

namespace dfr::sim::internal {

/// An off-screen OpenGL context, current on the thread that made it during its lifetime. All
/// drawing on a thread shares one context.
class GlContext {
 public:
  GlContext() = default;
  virtual ~GlContext() = default;
  GlContext(const GlContext&) = delete;
  GlContext& operator=(const GlContext&) = delete;

  /// Returns "OSMesa" or "EGL".
  [[nodiscard]] virtual const std::string& name() const noexcept = 0;

  /// Returns this thread's context. If there is none, creates one: OSMesa, or EGL if OSMesa fails
  /// or DFR_GL=egl requests it.
  /// @throws std::runtime_error with the messages of OSMesa and EGL.
  static std::shared_ptr<GlContext> OfThisThread();
};

}  // namespace dfr::sim::internal
