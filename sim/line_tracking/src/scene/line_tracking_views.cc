#include "scene/line_tracking_views.h"

namespace dfr::sim::internal {
namespace {

// Groups of geoms in the model.
constexpr int kToolGroup = 1;
constexpr int kOutsideGroup = 2;

MujocoRendererOptions Options(bool outside) {
  MujocoRendererOptions options;
  options.width = SceneView::kWidth;
  options.height = SceneView::kHeight;
  options.camera = outside ? "outside" : "endoscope";
  options.effects = outside;
  return options;
}

}  // namespace

SceneView::SceneView(const SceneModel& scene, bool outside)
    : scene_(&scene),
      model_(scene.CopyMj()),
      renderer_(*model_, Options(outside)),
      rgb_(std::size_t{3} * kWidth * kHeight) {
  renderer_.ShowGroup(kOutsideGroup, outside);
}

std::span<const std::uint8_t> SceneView::Draw(const SceneData& data, const Contents& contents) {
  if (!drawn_ || drawn_->line.c != contents.line.c || drawn_->with_line != contents.with_line) {
    DrawGauze(*scene_, contents.line, contents.with_line, *model_);
    renderer_.UploadTexture(scene_->gauze_texture);
  }
  renderer_.ShowGroup(kToolGroup, contents.with_tool);
  drawn_ = contents;
  renderer_.DrawBottomUp(data.mj(), rgb_);
  return rgb_;
}

}  // namespace dfr::sim::internal
