#include "gl_context.h"

#include <EGL/egl.h>
#include <EGL/eglext.h>
#include <GL/osmesa.h>
#include <dlfcn.h>

#include <array>
#include <cstdlib>
#include <sstream>
#include <stdexcept>
#include <string_view>
#include <vector>

namespace dfr::sim::internal {
namespace {

// MuJoCo detects which of these libraries the process has loaded and takes OpenGL's functions from
// there, from EGL if both are present. Therefore neither is linked, and only the one in use is
// loaded.
class Library {
 public:
  explicit Library(const char* file) : handle_(dlopen(file, RTLD_NOW | RTLD_GLOBAL)) {
    if (handle_ == nullptr) throw std::runtime_error(dlerror());
  }

  template <typename Function>
  [[nodiscard]] Function* Get(const char* name) const {
    void* const symbol = dlsym(handle_, name);
    if (symbol == nullptr) throw std::runtime_error(dlerror());
    return reinterpret_cast<Function*>(symbol);
  }

 private:
  void* handle_;  // never unloaded: MuJoCo keeps the function pointers
};

class OsMesaContext final : public GlContext {
 public:
  OsMesaContext()
      : destroy_(library_.Get<decltype(OSMesaDestroyContext)>("OSMesaDestroyContext")),
        context_(library_.Get<decltype(OSMesaCreateContextExt)>("OSMesaCreateContextExt")(
            OSMESA_RGBA, 24, 8, 8, nullptr)) {
    if (context_ == nullptr) throw std::runtime_error("OSMesa cannot create a context");
    // MuJoCo draws into its own framebuffer; OSMesa only requires a buffer to exist.
    if (library_.Get<decltype(OSMesaMakeCurrent)>("OSMesaMakeCurrent")(
            context_, buffer_.data(), GL_UNSIGNED_BYTE, kSize, kSize) == GL_FALSE) {
      destroy_(context_);
      throw std::runtime_error("OSMesa cannot make its context current");
    }
  }
  ~OsMesaContext() override { destroy_(context_); }
  [[nodiscard]] const std::string& name() const noexcept override { return name_; }

 private:
  static constexpr int kSize = 16;
  std::string name_ = "OSMesa";
  Library library_{"libOSMesa.so.8"};
  decltype(OSMesaDestroyContext)* destroy_;
  std::vector<unsigned char> buffer_ = std::vector<unsigned char>(4 * kSize * kSize);
  OSMesaContext context_;
};

struct EglFunctions {
  Library library{"libEGL.so.1"};
#define DFR_EGL(member, name) /* NOLINTNEXTLINE(bugprone-macro-parentheses) */ \
  decltype(name)* member = library.Get<decltype(name)>(#name)
  DFR_EGL(get_proc_address, eglGetProcAddress);
  DFR_EGL(get_display, eglGetDisplay);
  DFR_EGL(initialize, eglInitialize);
  DFR_EGL(choose_config, eglChooseConfig);
  DFR_EGL(bind_api, eglBindAPI);
  DFR_EGL(create_context, eglCreateContext);
  DFR_EGL(make_current, eglMakeCurrent);
  DFR_EGL(destroy_context, eglDestroyContext);
  DFR_EGL(terminate, eglTerminate);
  DFR_EGL(get_error, eglGetError);
#undef DFR_EGL
};

class EglContext final : public GlContext {
 public:
  EglContext() {
    const auto get_platform_display = reinterpret_cast<PFNEGLGETPLATFORMDISPLAYEXTPROC>(
        egl_.get_proc_address("eglGetPlatformDisplayEXT"));
    if (get_platform_display != nullptr) {
      display_ = get_platform_display(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, nullptr);
    }
    if (display_ == EGL_NO_DISPLAY) display_ = egl_.get_display(EGL_DEFAULT_DISPLAY);
    Check(display_ != EGL_NO_DISPLAY, "no display");
    Check(egl_.initialize(display_, nullptr, nullptr) == EGL_TRUE, "cannot be initialised");
    const std::array<EGLint, 13> wanted = {EGL_RED_SIZE,
                                           8,
                                           EGL_GREEN_SIZE,
                                           8,
                                           EGL_BLUE_SIZE,
                                           8,
                                           EGL_DEPTH_SIZE,
                                           24,
                                           EGL_SURFACE_TYPE,
                                           EGL_PBUFFER_BIT,
                                           EGL_RENDERABLE_TYPE,
                                           EGL_OPENGL_BIT,
                                           EGL_NONE};
    EGLConfig config = nullptr;
    EGLint configs = 0;
    Check(egl_.choose_config(display_, wanted.data(), &config, 1, &configs) == EGL_TRUE &&
              configs > 0,
          "has no configuration with 24 bits of depth");
    Check(egl_.bind_api(EGL_OPENGL_API) == EGL_TRUE, "has no OpenGL");
    context_ = egl_.create_context(display_, config, EGL_NO_CONTEXT, nullptr);
    Check(context_ != EGL_NO_CONTEXT, "cannot create a context");
    Check(egl_.make_current(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, context_) == EGL_TRUE,
          "cannot make its context current");
  }
  ~EglContext() override { Release(); }
  [[nodiscard]] const std::string& name() const noexcept override { return name_; }

 private:
  void Check(bool good, const char* what) {
    if (good) return;
    std::ostringstream message;
    message << "EGL " << what << " (error 0x" << std::hex << egl_.get_error() << ")";
    Release();
    throw std::runtime_error(message.str());
  }
  void Release() noexcept {
    if (display_ == EGL_NO_DISPLAY) return;
    egl_.make_current(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    if (context_ != EGL_NO_CONTEXT) egl_.destroy_context(display_, context_);
    egl_.terminate(display_);
  }

  std::string name_ = "EGL";
  EglFunctions egl_;
  EGLDisplay display_ = EGL_NO_DISPLAY;
  EGLContext context_ = EGL_NO_CONTEXT;
};

std::shared_ptr<GlContext> MakeOffscreen() {
  // MuJoCo keeps the functions of the first choice.
  static const bool egl = [] {
    const char* wanted = std::getenv("DFR_GL");
    return wanted != nullptr && std::string_view(wanted) == "egl";
  }();
  std::string failures;
  if (!egl) {
    try {
      return std::make_shared<OsMesaContext>();
    } catch (const std::runtime_error& e) {
      failures = std::string(e.what()) + "; ";
    }
  }
  try {
    return std::make_shared<EglContext>();
  } catch (const std::runtime_error& e) {
    throw std::runtime_error("cannot draw: " + failures + e.what());
  }
}

}  // namespace

std::shared_ptr<GlContext> GlContext::OfThisThread() {
  thread_local std::weak_ptr<GlContext> shared;
  std::shared_ptr<GlContext> context = shared.lock();
  if (context == nullptr) {
    context = MakeOffscreen();
    shared = context;
  }
  return context;
}

}  // namespace dfr::sim::internal
