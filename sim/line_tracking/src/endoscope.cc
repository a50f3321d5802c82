#include "dfr/sim/line_tracking/endoscope.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <memory>
#include <mutex>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "exposure.h"

namespace dfr::sim {
namespace {

constexpr int kNoiseEntries = 1 << 20;

}  // namespace

struct Endoscope::Tables {
  double fovy_rad = 0.0;
  std::vector<float> u;  // x/z of each pixel's ray
  std::vector<float> v;
  std::vector<float> noise;  // standard normal
  cv::Mat source;            // whole pixels of each ray's position in the pinhole picture
  cv::Mat source_fraction;   // remaining fraction of the position in 32nds of a pixel
};

std::shared_ptr<const Endoscope::Tables> Endoscope::MakeTables(const vision::CameraModel& camera) {
  auto tables = std::make_shared<Tables>();
  const auto width = static_cast<std::size_t>(camera.width);
  const std::size_t pixels = width * static_cast<std::size_t>(camera.height);
  tables->u.reserve(pixels);
  tables->v.reserve(pixels);
  double farthest_u = 0.0;
  double farthest_v = 0.0;
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      const Eigen::Vector2d ray = camera.ToNormalized({x, y});
      DFR_THROW_UNLESS(ray.allFinite(),
                       "endoscope: the lens distortion folds over at pixel " << x << ", " << y);
      tables->u.push_back(static_cast<float>(ray.x()));
      tables->v.push_back(static_cast<float>(ray.y()));
      farthest_u = std::max(farthest_u, std::abs(ray.x()));
      farthest_v = std::max(farthest_v, std::abs(ray.y()));
    }
  }
  // Focal length of the pinhole camera in pixels: the largest for which all rays stay within the
  // outermost pixel centres.
  const double center_x = 0.5 * (camera.width - 1);
  const double center_y = 0.5 * (camera.height - 1);
  const double focal = std::min(center_x / farthest_u, center_y / farthest_v);
  tables->fovy_rad = 2.0 * std::atan(0.5 * camera.height / focal);
  cv::Mat map_x(camera.height, camera.width, CV_32F);
  cv::Mat map_y(camera.height, camera.width, CV_32F);
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      const std::size_t i = static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x);
      map_x.at<float>(y, x) = static_cast<float>(center_x + focal * tables->u[i]);
      // The bottom row of the pinhole picture is first.
      map_y.at<float>(y, x) = static_cast<float>(center_y - focal * tables->v[i]);
    }
  }
  cv::convertMaps(map_x, map_y, tables->source, tables->source_fraction, CV_16SC2);
  core::Random random(640480);
  tables->noise.resize(static_cast<std::size_t>(kNoiseEntries) + width);
  for (float& value : tables->noise) value = static_cast<float>(random.Normal());
  return tables;
}

Endoscope::Endoscope(const vision::CameraModel& camera) : camera_(camera) {
  camera_.Check();
  // A process creates many plants with the same camera. Computing the camera's tables takes longer
  // than creating the rest of a plant.
  static std::mutex mutex;
  static vision::CameraModel last;
  static std::shared_ptr<const Tables> tables_of_last;
  const std::scoped_lock lock(mutex);
  if (tables_of_last == nullptr || !(last == camera_)) {
    tables_of_last = MakeTables(camera_);
    last = camera_;
  }
  tables_ = tables_of_last;
}

double Endoscope::pinhole_fovy_rad() const noexcept { return tables_->fovy_rad; }

std::size_t Endoscope::image_size() const noexcept {
  return 3 * static_cast<std::size_t>(camera_.width) * static_cast<std::size_t>(camera_.height);
}

vision::ImageView Endoscope::View(const std::uint8_t* bgr) const noexcept {
  return {bgr, camera_.width, camera_.height, 3 * static_cast<std::size_t>(camera_.width)};
}

void Endoscope::Develop(std::span<const std::uint8_t> pinhole_rgb, const EndoscopeLight& light,
                        std::uint64_t noise_seed, std::span<std::uint8_t> bgr) const {
  const auto to_float = [](double value) { return static_cast<float>(value); };
  // OpenCV does not accept a pointer to const.
  const cv::Mat pinhole(camera_.height, camera_.width, CV_8UC3,
                        const_cast<std::uint8_t*>(pinhole_rgb.data()));
  // The buffers persist, because allocating megabytes takes as long as the computation.
  thread_local cv::Mat rgb;
  thread_local std::array<cv::Mat, 3> colours;
  thread_local std::vector<float> gain;
  thread_local std::vector<float> glare;
  cv::remap(pinhole, rgb, tables_->source, tables_->source_fraction, cv::INTER_LINEAR,
            cv::BORDER_REPLICATE);
  if (light.blur_px > 0.0) cv::GaussianBlur(rgb, rgb, {}, light.blur_px);
  cv::split(rgb, colours);
  const internal::Exposure exposure{to_float(light.gain),         to_float(light.gradient.x()),
                                    to_float(light.gradient.y()), 0.35f,
                                    to_float(light.glare),        to_float(light.glare_at.x()),
                                    to_float(light.glare_at.y()), to_float(light.noise)};
  core::Random random(noise_seed);
  const auto width = static_cast<std::size_t>(camera_.width);
  gain.resize(width);
  glare.resize(width);
  for (int y = 0; y < camera_.height; ++y) {
    const std::size_t first = static_cast<std::size_t>(y) * width;
    internal::LightRow(exposure, tables_->u.data() + first, tables_->v.data() + first,
                       camera_.width, gain.data(), glare.data());
    // Each row and colour starts at another position in the table of noise.
    std::uint64_t bits = random();
    for (cv::Mat& colour : colours) {
      internal::ExposeRow(gain.data(), glare.data(), tables_->noise.data() + bits % kNoiseEntries,
                          exposure.noise, camera_.width, colour.ptr<std::uint8_t>(y));
      bits >>= 20;
    }
  }
  cv::Mat picture(camera_.height, camera_.width, CV_8UC3, bgr.data());
  cv::merge(std::array{colours[2], colours[1], colours[0]}, picture);
}

}  // namespace dfr::sim
