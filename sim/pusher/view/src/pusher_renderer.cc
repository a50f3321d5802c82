#include <mujoco/mujoco.h>

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/sim/pusher/pusher_view.h"
#include "offscreen_context.h"
#include "pusher_world.h"
#include "scene.h"

namespace dfr::sim {

struct PusherRenderer::Impl {
  Impl(const PusherPlant& plant, const PusherRendererOptions& chosen)
      : options(chosen),
        context(internal::OffscreenContext::Make()),
        scene(*plant.world().model),
        bottom_up(3 * static_cast<std::size_t>(options.width) *
                  static_cast<std::size_t>(options.height)) {
    mjr_setBuffer(mjFB_OFFSCREEN, &scene.context);
    if (scene.context.currentBuffer != mjFB_OFFSCREEN) {
      throw std::runtime_error("nothing can be drawn here: " + context->name() +
                               " has no off-screen buffer");
    }
    scene.camera.type = mjCAMERA_FIXED;
    scene.camera.fixedcamid =
        mj_name2id(plant.world().model.get(), mjOBJ_CAMERA,
                   options.camera == PusherCamera::kOverhead ? "overhead" : "angled");
  }

  PusherRendererOptions options;
  std::unique_ptr<internal::OffscreenContext> context;  // outlives the scene's OpenGL objects
  internal::Scene scene;
  std::vector<std::uint8_t> bottom_up;
};

PusherRenderer::PusherRenderer(const PusherPlant& plant, const PusherRendererOptions& options) {
  DFR_THROW_UNLESS(options.width >= 16 && options.width <= 1920 && options.height >= 16 &&
                       options.height <= 1080,
                   "a picture of " << options.width << " x " << options.height
                                   << " pixels is not within 16 x 16 to 1920 x 1080");
  impl_ = std::make_unique<Impl>(plant, options);
}

PusherRenderer::~PusherRenderer() = default;
PusherRenderer::PusherRenderer(PusherRenderer&&) noexcept = default;
PusherRenderer& PusherRenderer::operator=(PusherRenderer&&) noexcept = default;

const std::string& PusherRenderer::backend() const noexcept { return impl_->context->name(); }

void PusherRenderer::Draw(const PusherPlant& plant, std::span<std::uint8_t> rgb) {
  Impl& impl = *impl_;
  const mjrRect viewport = {0, 0, impl.options.width, impl.options.height};
  impl.scene.Draw(*plant.data().mj, viewport);
  mjr_readPixels(impl.bottom_up.data(), nullptr, viewport, &impl.scene.context);
  // OpenGL's rows begin at the bottom.
  const std::size_t row = 3 * static_cast<std::size_t>(impl.options.width);
  const auto rows = static_cast<std::size_t>(impl.options.height);
  for (std::size_t i = 0; i < rows; ++i) {
    std::copy_n(&impl.bottom_up[(rows - 1 - i) * row], row, &rgb[i * row]);
  }
}

}  // namespace dfr::sim
