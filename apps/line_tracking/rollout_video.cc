#include "rollout_video.h"

#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "apps/rollout_video.h"
#include "apps/video_writer.h"
#include "dfr/core/text/format.h"

namespace dfr::apps::line_tracking {
namespace {

using sim::LineTrackingPlant;

constexpr int kWidth = kPictureWidth / 2;
constexpr int kHeight = kPictureHeight;
constexpr int kRecoveryStride = 10;

// Channels are blue, green, red.
const cv::Scalar kSeen(220, 200, 0);

void Write(cv::Mat& canvas, const std::string& text, cv::Point at, const cv::Scalar& colour,
           double scale = 0.5) {
  cv::putText(canvas, text, at, cv::FONT_HERSHEY_SIMPLEX, scale, colour, 1, cv::LINE_AA);
}

// Draws the results of vision over `picture`.
void DrawSeen(cv::Mat& picture, const LineTrackingPlant& plant) {
  if (plant.options().observation == sim::Observation::kGroundTruth) {
    Write(picture,
          core::Format("not looked at: true distance %+.2f mm  tracked %.1f mm",
                       1e3 * plant.truth().distance_m, 1e3 * plant.truth().progress_m),
          {20, 460}, kSeen, 0.55);
    return;
  }
  const vision::LineObservation& seen = plant.last_observation();
  if (!seen.seen()) {
    Write(picture, std::string("not seen: ") + vision::Name(seen.missing), {20, 460}, kSeen, 0.6);
    return;
  }
  const vision::CameraModel& camera = plant.calibration().camera;
  const auto to_point = [](const Eigen::Vector2d& p) {
    return cv::Point(static_cast<int>(std::lround(p.x())), static_cast<int>(std::lround(p.y())));
  };
  std::vector<cv::Point> curve;
  curve.reserve(61);
  constexpr int kPieces = 60;
  for (int i = 0; i <= kPieces; ++i) {
    const double x = seen.x_min + (seen.x_max - seen.x_min) * i / kPieces;
    const double y = seen.line[0] + x * (seen.line[1] + x * seen.line[2]);
    curve.push_back(to_point(camera.Project(seen.p_cam_target * Eigen::Vector3d(x, y, 0.0))));
  }
  cv::polylines(picture, curve, false, kSeen, 1, cv::LINE_AA);
  cv::circle(picture, to_point(seen.tip_pixel), 12, kSeen, 1, cv::LINE_AA);
  Write(picture,
        core::Format("distance %+.2f mm (true %+.2f)  tracked %.1f mm", 1e3 * seen.distance_m,
                     1e3 * plant.truth().distance_m, 1e3 * plant.truth().progress_m),
        {20, 460}, kSeen, 0.55);
}

}  // namespace

void DrawBothViews(const LineTrackingPlant& plant, std::span<std::uint8_t> rgb) {
  cv::Mat picture(kHeight, 2 * kWidth, CV_8UC3, rgb.data());
  std::vector<std::uint8_t> bytes(plant.endoscope().image_size());
  cv::Mat view(kHeight, kWidth, CV_8UC3, bytes.data());
  plant.RenderEndoscope(bytes);
  DrawSeen(view, plant);
  cv::cvtColor(view, picture(cv::Rect(0, 0, kWidth, kHeight)), cv::COLOR_BGR2RGB);
  plant.RenderOutside(bytes);
  view.copyTo(picture(cv::Rect(kWidth, 0, kWidth, kHeight)));
}

void CheckFilm(const std::filesystem::path& path, const sim::LineTrackingOptions& options) {
  sim::LineTrackingPlant plant(options);
  plant.Reset(0);
  CheckVideo(path, kPictureWidth, kPictureHeight,
             [&plant](std::span<std::uint8_t> rgb) { DrawBothViews(plant, rgb); });
}

RolloutVideo Record(LineTrialRunner& runner, int method, const std::string& title,
                    std::uint64_t start_seed, std::uint64_t controller_seed) {
  const LineTrackingPlant& plant = runner.plant();
  const auto draw = [&plant](std::span<std::uint8_t> rgb) { DrawBothViews(plant, rgb); };
  RolloutVideoRecorder recorder(title, kPictureWidth, kPictureHeight, draw,
                                runner.model().task().support(), kRecoveryStride);
  runner.RunObserved(method, start_seed, controller_seed, &recorder);
  return recorder.Take();
}

control::RolloutResult RecordEpisode(LineTrialRunner& runner, int method, const std::string& title,
                                     std::uint64_t start_seed, std::uint64_t controller_seed,
                                     const std::filesystem::path& path) {
  const RolloutVideo video = Record(runner, method, title, start_seed, controller_seed);
  WriteVideo(path, {&video, 1});
  return video.result;
}

}  // namespace dfr::apps::line_tracking
