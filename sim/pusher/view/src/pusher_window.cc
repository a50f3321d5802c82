#include <GLFW/glfw3.h>
#include <mujoco/mujoco.h>

#include <memory>
#include <stdexcept>

#include "dfr/sim/pusher/pusher_view.h"
#include "pusher_world.h"
#include "scene.h"

namespace dfr::sim {
namespace {

struct WindowDeleter {
  void operator()(GLFWwindow* window) const noexcept {
    glfwDestroyWindow(window);
    glfwTerminate();
  }
};
using Window = std::unique_ptr<GLFWwindow, WindowDeleter>;

Window OpenWindow(const std::string& title) {
  if (glfwInit() == GLFW_FALSE) {
    throw std::runtime_error(
        "no window can be opened: there is no display. Without one, use pusher render");
  }
  glfwWindowHint(GLFW_SAMPLES, 4);
  GLFWwindow* window = glfwCreateWindow(1100, 800, title.c_str(), nullptr, nullptr);
  if (window == nullptr) {
    const char* reason = nullptr;
    glfwGetError(&reason);
    const std::string message = reason == nullptr ? "unknown" : reason;
    glfwTerminate();
    throw std::runtime_error("no window can be opened: " + message +
                             ". Without one, use pusher render");
  }
  glfwMakeContextCurrent(window);
  glfwSwapInterval(1);
  return Window(window);
}

}  // namespace

struct PusherWindow::Impl {
  Impl(const PusherPlant& plant, const std::string& title)
      : window(OpenWindow(title)), scene(*plant.world().model) {
    scene.camera.type = mjCAMERA_FREE;
    scene.camera.lookat[0] = 0.5;
    scene.camera.lookat[1] = 0.0;
    scene.camera.lookat[2] = -0.25;
    scene.camera.distance = 1.6;
    scene.camera.azimuth = 140.0;
    scene.camera.elevation = -35.0;
    glfwSetWindowUserPointer(window.get(), this);
    glfwSetScrollCallback(window.get(), [](GLFWwindow* w, double, double dy) {
      auto* impl = static_cast<Impl*>(glfwGetWindowUserPointer(w));
      mjv_moveCamera(impl->scene.model, mjMOUSE_ZOOM, 0.0, -0.05 * dy, &impl->scene.scene,
                     &impl->scene.camera);
    });
    glfwSetCursorPosCallback(window.get(), [](GLFWwindow* w, double x, double y) {
      static_cast<Impl*>(glfwGetWindowUserPointer(w))->MoveMouse(x, y);
    });
  }

  // Left button turns, right button moves.
  void MoveMouse(double x, double y) {
    const double dx = x - last_x;
    const double dy = y - last_y;
    last_x = x;
    last_y = y;
    const bool left = glfwGetMouseButton(window.get(), GLFW_MOUSE_BUTTON_LEFT) == GLFW_PRESS;
    const bool right = glfwGetMouseButton(window.get(), GLFW_MOUSE_BUTTON_RIGHT) == GLFW_PRESS;
    if (!left && !right) return;
    int width = 1;
    int height = 1;
    glfwGetWindowSize(window.get(), &width, &height);
    mjv_moveCamera(scene.model, left ? mjMOUSE_ROTATE_V : mjMOUSE_MOVE_H, dx / height, dy / height,
                   &scene.scene, &scene.camera);
  }

  Window window;  // outlives the scene's OpenGL objects
  internal::Scene scene;
  double last_x = 0.0;
  double last_y = 0.0;
};

PusherWindow::PusherWindow(const PusherPlant& plant, const std::string& title)
    : impl_(std::make_unique<Impl>(plant, title)) {}

PusherWindow::~PusherWindow() = default;

bool PusherWindow::Show(const PusherPlant& plant, const std::string& first_line,
                        const std::string& second_line, double seconds) {
  Impl& impl = *impl_;
  const double until = glfwGetTime() + seconds;
  do {
    mjrRect viewport = {0, 0, 0, 0};
    glfwGetFramebufferSize(impl.window.get(), &viewport.width, &viewport.height);
    impl.scene.Draw(*plant.data().mj, viewport);
    mjr_overlay(mjFONT_NORMAL, mjGRID_TOPLEFT, viewport, (first_line + "\n" + second_line).c_str(),
                nullptr, &impl.scene.context);
    glfwSwapBuffers(impl.window.get());
    glfwPollEvents();
    if (glfwWindowShouldClose(impl.window.get()) != 0) return false;
  } while (glfwGetTime() < until);
  return true;
}

}  // namespace dfr::sim
