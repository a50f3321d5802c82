#include <GLFW/glfw3.h>
#include <mujoco/mujoco.h>

#include <algorithm>
#include <memory>
#include <stdexcept>
#include <vector>

#include "dfr/sim/mujoco_view/mujoco_view.h"
#include "gl_context.h"
#include "scene.h"

namespace dfr::sim {
namespace {

class WindowContext final : public internal::GlContext {
 public:
  explicit WindowContext(const MujocoWindowOptions& options) {
    if (glfwInit() == GLFW_FALSE) {
      throw std::runtime_error("cannot open a window: there is no display. Without one, use " +
                               options.instead);
    }
    glfwWindowHint(GLFW_SAMPLES, 4);
    window_ = glfwCreateWindow(1100, 800, options.title.c_str(), nullptr, nullptr);
    if (window_ == nullptr) {
      const char* reason = nullptr;
      glfwGetError(&reason);
      const std::string message = reason == nullptr ? "unknown" : reason;
      glfwTerminate();
      throw std::runtime_error("cannot open a window: " + message + ". Without one, use " +
                               options.instead);
    }
    glfwMakeContextCurrent(window_);
    glfwSwapInterval(1);
  }
  ~WindowContext() override {
    glfwDestroyWindow(window_);
    glfwTerminate();
  }
  [[nodiscard]] const std::string& name() const noexcept override { return name_; }
  [[nodiscard]] GLFWwindow* window() const noexcept { return window_; }

 private:
  std::string name_ = "GLFW";
  GLFWwindow* window_ = nullptr;
};

std::shared_ptr<WindowContext> Open(const MujocoWindowOptions& options) {
  auto context = std::make_shared<WindowContext>(options);
  internal::GlContext::Adopt(context);
  return context;
}

}  // namespace

struct MujocoWindow::Impl {
  Impl(const mjModel& model, const MujocoWindowOptions& options) : gl(Open(options)), scene(model) {
    scene.camera.type = mjCAMERA_FREE;
    std::copy_n(options.look_at.begin(), 3, scene.camera.lookat);
    scene.camera.distance = options.distance;
    scene.camera.azimuth = options.azimuth;
    scene.camera.elevation = options.elevation;
    glfwSetWindowUserPointer(gl->window(), this);
    glfwSetScrollCallback(gl->window(), [](GLFWwindow* w, double, double dy) {
      auto* impl = static_cast<Impl*>(glfwGetWindowUserPointer(w));
      mjv_moveCamera(impl->scene.model, mjMOUSE_ZOOM, 0.0, -0.05 * dy, &impl->scene.scene,
                     &impl->scene.camera);
    });
    glfwSetCursorPosCallback(gl->window(), [](GLFWwindow* w, double x, double y) {
      static_cast<Impl*>(glfwGetWindowUserPointer(w))->MoveMouse(x, y);
    });
  }

  // The left button turns the view, and the right button moves it.
  void MoveMouse(double x, double y) {
    const double dx = x - last_x;
    const double dy = y - last_y;
    last_x = x;
    last_y = y;
    const bool left = glfwGetMouseButton(gl->window(), GLFW_MOUSE_BUTTON_LEFT) == GLFW_PRESS;
    const bool right = glfwGetMouseButton(gl->window(), GLFW_MOUSE_BUTTON_RIGHT) == GLFW_PRESS;
    if (!left && !right) return;
    int width = 1;
    int height = 1;
    glfwGetWindowSize(gl->window(), &width, &height);
    mjv_moveCamera(scene.model, left ? mjMOUSE_ROTATE_V : mjMOUSE_MOVE_H, dx / height, dy / height,
                   &scene.scene, &scene.camera);
  }

  // Draws in the lower right corner. OpenGL's rows start at the bottom.
  void DrawInset(const Inset& inset, const mjrRect& window) {
    const auto row = 3 * static_cast<std::size_t>(inset.width);
    const auto rows = static_cast<std::size_t>(inset.height);
    bottom_up.resize(row * rows);
    for (std::size_t i = 0; i < rows; ++i) {
      std::copy_n(&inset.rgb[(rows - 1 - i) * row], row, &bottom_up[i * row]);
    }
    const mjrRect corner = {std::max(0, window.width - inset.width), 0, inset.width, inset.height};
    mjr_drawPixels(bottom_up.data(), nullptr, corner, &scene.context);
  }

  std::shared_ptr<WindowContext> gl;  // outlives the scene's OpenGL objects
  internal::Scene scene;
  std::vector<std::uint8_t> bottom_up;
  double last_x = 0.0;
  double last_y = 0.0;
};

MujocoWindow::MujocoWindow(const mjModel& model, const MujocoWindowOptions& options)
    : impl_(std::make_unique<Impl>(model, options)) {}

MujocoWindow::~MujocoWindow() = default;

void MujocoWindow::UploadTexture(int texture) {
  mjr_uploadTexture(impl_->scene.model, &impl_->scene.context, texture);
}

bool MujocoWindow::Show(const mjData& data, const std::string& first_line,
                        const std::string& second_line, double seconds, const Inset& inset) {
  Impl& impl = *impl_;
  const double until = glfwGetTime() + seconds;
  do {
    mjrRect viewport = {0, 0, 0, 0};
    glfwGetFramebufferSize(impl.gl->window(), &viewport.width, &viewport.height);
    impl.scene.Update(data);
    mjr_setBuffer(mjFB_WINDOW, &impl.scene.context);
    impl.scene.Render(viewport);
    if (!inset.rgb.empty()) impl.DrawInset(inset, viewport);
    mjr_overlay(mjFONT_NORMAL, mjGRID_TOPLEFT, viewport, (first_line + "\n" + second_line).c_str(),
                nullptr, &impl.scene.context);
    glfwSwapBuffers(impl.gl->window());
    glfwPollEvents();
    if (glfwWindowShouldClose(impl.gl->window()) != 0) return false;
  } while (glfwGetTime() < until);
  return true;
}

}  // namespace dfr::sim
