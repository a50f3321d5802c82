#include "dfr/sim/mujoco_view/mujoco_view.h"
#include "dfr/sim/pusher/pusher_view.h"
#include "pusher_world.h"

namespace dfr::sim {

struct PusherWindow::Impl {
  MujocoWindow window;
};

PusherWindow::PusherWindow(const PusherPlant& plant, const std::string& title)
    : impl_(new Impl{{*plant.world().model,
                      {.title = title,
                       .instead = "pusher render",
                       .look_at = {0.5, 0.0, -0.25},
                       .distance = 1.6,
                       .azimuth = 140.0,
                       .elevation = -35.0}}}) {}

PusherWindow::~PusherWindow() = default;

bool PusherWindow::Show(const PusherPlant& plant, const std::string& first_line,
                        const std::string& second_line, double seconds) {
  return impl_->window.Show(*plant.data().mj, first_line, second_line, seconds);
}

}  // namespace dfr::sim
