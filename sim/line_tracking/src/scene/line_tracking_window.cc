#include "dfr/sim/line_tracking/line_tracking_window.h"

#include <optional>

#include "dfr/sim/mujoco_view/mujoco_view.h"
#include "scene/line_tracking_scene.h"
#include "scene/line_tracking_simulation.h"

namespace dfr::sim {

struct LineTrackingWindow::Impl {
  explicit Impl(const std::string& title)
      : scene({LineTrackingPlant::p_world_base(), LineTrackingPlant::p_world_cam(),
               Endoscope(LineTrackingPlant::true_camera()).pinhole_fovy_rad(),
               LineTrackingPlant::target().marks_m}),
        model(scene.CopyMj()),
        window(*model, {.title = title,
                        .instead = "line_tracking render",
                        .look_at = {0.0, 0.0, -0.01},
                        .distance = 0.45,
                        .azimuth = 130.0,
                        .elevation = -30.0}) {}

  internal::SceneModel scene;
  MjModelPtr model;  // with the most recently drawn gauze
  MujocoWindow window;
  std::optional<internal::GauzeLine> drawn;
};

LineTrackingWindow::LineTrackingWindow(const std::string& title)
    : impl_(std::make_unique<Impl>(title)) {}

LineTrackingWindow::~LineTrackingWindow() = default;

bool LineTrackingWindow::Show(const LineTrackingPlant& plant, const std::string& first_line,
                              const std::string& second_line, double seconds,
                              std::span<const std::uint8_t> rgb) {
  Impl& impl = *impl_;
  const internal::GauzeLine line = plant.line();
  if (!impl.drawn || impl.drawn->c != line.c) {
    internal::DrawGauze(impl.scene, line, true, *impl.model);
    impl.window.UploadTexture(impl.scene.gauze_texture);
    impl.drawn = line;
  }
  plant.simulation_->data.PlaceLegs();
  return impl.window.Show(plant.simulation_->data.mj(), first_line, second_line, seconds,
                          {rgb, 320, 240});
}

}  // namespace dfr::sim
