#pragma once

#include <memory>
#include <string>

namespace dfr::sim::internal {

/// An OpenGL context without a window, current on this thread while it lives.
class OffscreenContext {
 public:
  virtual ~OffscreenContext() = default;
  [[nodiscard]] virtual const std::string& name() const noexcept = 0;

  /// OSMesa, or EGL where that fails or DFR_GL=egl asks for it.
  /// @throws std::runtime_error with what each said.
  static std::unique_ptr<OffscreenContext> Make();
};

}  // namespace dfr::sim::internal
