#include "dfr/sim/line_tracking/endoscope.h"

#include <algorithm>
#include <cmath>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "endoscope_raster.h"

namespace dfr::sim {
namespace {

constexpr int kNoiseEntries = 1 << 14;

// Rows and columns that a shape may touch.
struct Box {
  int x0 = 0;
  int y0 = 0;
  int x1 = 0;
  int y1 = 0;
};

// A rod's end: where it is in the normalised image, and how large.
struct End {
  Eigen::Vector2d at = Eigen::Vector2d::Zero();
  double radius = 0.0;
};

End ToEnd(const Eigen::Vector3d& p_cam, double radius_m) noexcept {
  return {p_cam.head<2>() / p_cam.z(), radius_m / p_cam.z()};
}

}  // namespace

struct Endoscope::Tables {
  std::vector<float> u;  // x/z of each pixel's ray
  std::vector<float> v;
  std::vector<float> noise;  // standard normal
};

Endoscope::Endoscope(const vision::CameraModel& camera) : camera_(camera) {
  camera_.Check();
  DFR_THROW_UNLESS(
      camera_.width <= internal::Row::kMaxWidth,
      "endoscope: at most " << internal::Row::kMaxWidth << " pixels wide, not " << camera_.width);
  auto tables = std::make_shared<Tables>();
  const auto pixels =
      static_cast<std::size_t>(camera_.width) * static_cast<std::size_t>(camera_.height);
  tables->u.reserve(pixels);
  tables->v.reserve(pixels);
  for (int y = 0; y < camera_.height; ++y) {
    for (int x = 0; x < camera_.width; ++x) {
      const Eigen::Vector2d ray = camera_.ToNormalized({x, y});
      DFR_THROW_UNLESS(ray.allFinite(),
                       "endoscope: the lens distortion folds over at pixel " << x << ", " << y);
      tables->u.push_back(static_cast<float>(ray.x()));
      tables->v.push_back(static_cast<float>(ray.y()));
    }
  }
  core::Random random(640480);
  tables->noise.resize(static_cast<std::size_t>(kNoiseEntries + camera_.width));
  for (float& value : tables->noise) value = static_cast<float>(random.Normal());
  tables_ = std::move(tables);
}

std::size_t Endoscope::image_size() const noexcept {
  return 3 * static_cast<std::size_t>(camera_.width) * static_cast<std::size_t>(camera_.height);
}

vision::ImageView Endoscope::View(const std::uint8_t* bgr) const noexcept {
  return {bgr, camera_.width, camera_.height, 3 * static_cast<std::size_t>(camera_.width)};
}

void Endoscope::Render(const EndoscopeScene& scene, const EndoscopeLight& light,
                       std::uint64_t noise_seed, std::uint8_t* bgr) const noexcept {
  const auto to_float = [](double value) { return static_cast<float>(value); };
  const double ramp_px = 1.0 + 2.0 * light.blur_px;
  const double normalized_edge = ramp_px / camera_.fx;
  const Eigen::Matrix3d r = scene.p_cam_gauze.linear();
  const Eigen::Vector3d t = scene.p_cam_gauze.translation();
  internal::Plane plane{};
  for (int k = 0; k < 3; ++k) {
    plane.x_axis[k] = to_float(r(k, 0));
    plane.y_axis[k] = to_float(r(k, 1));
    plane.normal[k] = to_float(r(k, 2));
    plane.line[k] = to_float(scene.line[k]);
  }
  plane.offset_x = to_float(r.col(0).dot(t));
  plane.offset_y = to_float(r.col(1).dot(t));
  plane.distance = to_float(r.col(2).dot(t));
  plane.line_half_length = to_float(scene.line_half_length_m > 0 ? scene.line_half_length_m : -1.0);
  plane.line_half_width = to_float(0.5 * scene.line_width_m);
  plane.edge = to_float(normalized_edge * t.z());

  // A box of pixels around points of the normalised image, `margin` pixels wider.
  const auto box = [this](std::initializer_list<End> ends, double margin) {
    double x0 = camera_.width;
    double y0 = camera_.height;
    double x1 = 0.0;
    double y1 = 0.0;
    for (const End& end : ends) {
      for (int k = 0; k < 8; ++k) {
        const Eigen::Vector2d corner = camera_.ToPixel(
            end.at + 1.1 * end.radius * Eigen::Vector2d((k % 3) - 1.0, (k / 3) - 1.0));
        x0 = std::min(x0, corner.x());
        y0 = std::min(y0, corner.y());
        x1 = std::max(x1, corner.x());
        y1 = std::max(y1, corner.y());
      }
      const Eigen::Vector2d corner =
          camera_.ToPixel(end.at + 1.1 * end.radius * Eigen::Vector2d(1.0, 1.0));
      x1 = std::max(x1, corner.x());
      y1 = std::max(y1, corner.y());
    }
    const auto clip = [](double value, int size) {
      return static_cast<int>(std::clamp(value, 0.0, static_cast<double>(size)));
    };
    return Box{clip(x0 - margin, camera_.width), clip(y0 - margin, camera_.height),
               clip(x1 + margin + 1.0, camera_.width), clip(y1 + margin + 1.0, camera_.height)};
  };

  constexpr std::size_t kMaxMarks = 32;
  std::array<Box, kMaxMarks> mark_box{};
  const std::size_t marks =
      scene.marks_m == nullptr ? 0 : std::min(kMaxMarks, scene.marks_m->size());
  for (std::size_t i = 0; i < marks; ++i) {
    const Eigen::Vector2d& m = (*scene.marks_m)[i];
    const Eigen::Vector3d p = scene.p_cam_gauze * Eigen::Vector3d(m.x(), m.y(), 0.0);
    if (p.z() > 1e-3) mark_box[i] = box({ToEnd(p, scene.mark_radius_m)}, ramp_px + 2.0);
  }

  // Shaft, wrist, jaws and the ball at the tip, back to front.
  struct Part {
    internal::Rod rod;
    Box box;
  };
  std::array<Part, 4> parts{};
  const auto part = [&](const Eigen::Vector3d& a, double ra, const Eigen::Vector3d& b, double rb) {
    Part made{};
    if (!(a.z() > 1e-3) || !(b.z() > 1e-3)) return made;
    const End from = ToEnd(a, ra);
    const End to = ToEnd(b, rb);
    made.box = box({from, to}, ramp_px + 2.0);
    made.rod = {to_float(from.at.x()),
                to_float(from.at.y()),
                to_float(to.at.x()),
                to_float(to.at.y()),
                to_float(from.radius),
                to_float(to.radius),
                to_float(normalized_edge),
                0.42f,
                0.42f,
                0.42f,
                0.5f};
    return made;
  };
  const auto& tool = scene.tool_cam;
  parts[0] = part(tool[2], 0.0042, tool[3], 0.0042);
  parts[1] = part(tool[1], 0.0025, tool[2], 0.0038);
  parts[2] = part(tool[0], 0.0006, tool[1], 0.0022);
  parts[3] = part(tool[0], scene.tip_radius_m, tool[0], scene.tip_radius_m);
  parts[0].rod.b = parts[0].rod.g = parts[0].rod.r = 0.22f;
  parts[3].rod.b = 0.20f;
  parts[3].rod.g = 0.62f;
  parts[3].rod.r = 0.12f;
  parts[3].rod.shade = 0.15f;

  const internal::Light exposure{to_float(light.gain),         to_float(light.gradient.x()),
                                 to_float(light.gradient.y()), 0.35f,
                                 to_float(light.glare),        to_float(light.glare_at.x()),
                                 to_float(light.glare_at.y()), to_float(light.noise)};
  core::Random random(noise_seed);
  internal::Row row;
  const auto width = static_cast<std::size_t>(camera_.width);
  for (int y = 0; y < camera_.height; ++y) {
    const std::size_t first = static_cast<std::size_t>(y) * width;
    const float* u = tables_->u.data() + first;
    const float* v = tables_->v.data() + first;
    internal::DrawPlane(plane, u, v, camera_.width, row);
    for (std::size_t i = 0; i < marks; ++i) {
      if (y < mark_box[i].y0 || y >= mark_box[i].y1) continue;
      const Eigen::Vector2d& m = (*scene.marks_m)[i];
      internal::DrawMark(to_float(m.x()), to_float(m.y()), to_float(scene.mark_radius_m),
                         plane.edge, mark_box[i].x0, mark_box[i].x1, row);
    }
    for (const Part& p : parts) {
      if (y >= p.box.y0 && y < p.box.y1) internal::DrawRod(p.rod, u, v, p.box.x0, p.box.x1, row);
    }
    const std::uint64_t bits = random();
    const auto offset = [bits, this](int shift) {
      return tables_->noise.data() + (bits >> shift) % kNoiseEntries;
    };
    internal::Expose(exposure, u, v, offset(0), offset(20), offset(40), camera_.width, row,
                     bgr + 3 * first);
  }
}

}  // namespace dfr::sim
