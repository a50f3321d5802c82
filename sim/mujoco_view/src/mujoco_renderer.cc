#include <mujoco/mujoco.h>

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/sim/mujoco_view/mujoco_view.h"
#include "gl_context.h"
#include "scene.h"

namespace dfr::sim {

struct MujocoRenderer::Impl {
  Impl(const mjModel& model, const MujocoRendererOptions& chosen, int camera)
      : options(chosen), gl(internal::GlContext::OfThisThread()), scene(model) {
    mjr_setBuffer(mjFB_OFFSCREEN, &scene.context);
    if (scene.context.currentBuffer != mjFB_OFFSCREEN) {
      throw std::runtime_error("cannot draw: " + gl->name() + " has no off-screen buffer");
    }
    scene.camera.type = mjCAMERA_FIXED;
    scene.camera.fixedcamid = camera;
    if (!options.effects) {
      for (const int flag : {mjRND_SHADOW, mjRND_REFLECTION, mjRND_SKYBOX, mjRND_FOG, mjRND_HAZE}) {
        scene.scene.flags[flag] = 0;
      }
    }
  }

  MujocoRendererOptions options;
  std::shared_ptr<internal::GlContext> gl;  // outlives the scene's OpenGL objects
  internal::Scene scene;
  std::vector<std::uint8_t> bottom_up;
};

MujocoRenderer::MujocoRenderer(const mjModel& model, const MujocoRendererOptions& options) {
  DFR_THROW_UNLESS(options.width >= 16 && options.width <= 1920 && options.height >= 16 &&
                       options.height <= 1080,
                   "a picture of " << options.width << " x " << options.height
                                   << " pixels is not within 16 x 16 to 1920 x 1080");
  const int camera = mj_name2id(&model, mjOBJ_CAMERA, options.camera.c_str());
  DFR_THROW_UNLESS(camera >= 0, "the model has no camera '" << options.camera << "'");
  impl_ = std::make_unique<Impl>(model, options, camera);
}

MujocoRenderer::~MujocoRenderer() = default;
MujocoRenderer::MujocoRenderer(MujocoRenderer&&) noexcept = default;
MujocoRenderer& MujocoRenderer::operator=(MujocoRenderer&&) noexcept = default;

void MujocoRenderer::ShowGroup(int group, bool visible) {
  DFR_THROW_UNLESS(group >= 0 && group < mjNGROUP,
                   "a group of geoms lies in [0, " << mjNGROUP << "), not " << group);
  impl_->scene.option.geomgroup[group] = static_cast<mjtByte>(visible);
}

void MujocoRenderer::UploadTexture(int texture) {
  mjr_uploadTexture(impl_->scene.model, &impl_->scene.context, texture);
}

void MujocoRenderer::DrawBottomUp(const mjData& data, std::span<std::uint8_t> rgb) {
  Impl& impl = *impl_;
  const mjrRect viewport = {0, 0, impl.options.width, impl.options.height};
  impl.scene.Update(data);
  if (impl.options.decorate) impl.options.decorate(impl.scene.scene);
  // Another renderer of this thread may have drawn in between.
  mjr_restoreBuffer(&impl.scene.context);
  impl.scene.Render(viewport);
  mjr_readPixels(rgb.data(), nullptr, viewport, &impl.scene.context);
}

void MujocoRenderer::Draw(const mjData& data, std::span<std::uint8_t> rgb) {
  Impl& impl = *impl_;
  impl.bottom_up.resize(rgb.size());
  DrawBottomUp(data, impl.bottom_up);
  const std::size_t row = 3 * static_cast<std::size_t>(impl.options.width);
  const auto rows = static_cast<std::size_t>(impl.options.height);
  for (std::size_t i = 0; i < rows; ++i) {
    std::copy_n(&impl.bottom_up[(rows - 1 - i) * row], row, &rgb[i * row]);
  }
}

}  // namespace dfr::sim
