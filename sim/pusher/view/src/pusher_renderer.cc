#include <mujoco/mujoco.h>

#include "dfr/sim/mujoco_view/mujoco_view.h"
#include "dfr/sim/pusher/pusher_view.h"
#include "pusher_world.h"

namespace dfr::sim {
namespace {

// Makes the arm's links translucent, because they hide the gripper from above.
void FadeArm(mjvScene& scene) {
  constexpr mjtNum kAboveGripper = -0.2;  // m
  for (int i = 0; i < scene.ngeom; ++i) {
    if (scene.geoms[i].pos[2] < kAboveGripper) continue;
    scene.geoms[i].rgba[3] *= 0.25f;
    scene.geoms[i].transparent = 1;
  }
}

}  // namespace

struct PusherRenderer::Impl {
  MujocoRenderer renderer;
};

PusherRenderer::PusherRenderer(const PusherPlant& plant, const PusherRendererOptions& options) {
  MujocoRendererOptions chosen;
  chosen.width = options.width;
  chosen.height = options.height;
  chosen.camera = options.camera == PusherCamera::kOverhead ? "overhead" : "angled";
  if (options.camera == PusherCamera::kOverhead) chosen.decorate = FadeArm;
  impl_ = std::make_unique<Impl>(Impl{MujocoRenderer(*plant.world().model, chosen)});
}

PusherRenderer::~PusherRenderer() = default;
PusherRenderer::PusherRenderer(PusherRenderer&&) noexcept = default;
PusherRenderer& PusherRenderer::operator=(PusherRenderer&&) noexcept = default;

void PusherRenderer::Draw(const PusherPlant& plant, std::span<std::uint8_t> rgb) {
  impl_->renderer.Draw(*plant.data().mj, rgb);
}

}  // namespace dfr::sim
