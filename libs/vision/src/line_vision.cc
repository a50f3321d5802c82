#include "dfr/vision/line_vision.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "colour_blobs.h"
#include "dfr/core/contract.h"
#include "dfr/core/numerics/quantile.h"
#include "exposure.h"
#include "plane_pose.h"
#include "robust_quadratic.h"

namespace dfr::vision {
namespace {

using internal::Blob;
using internal::Exposure;
using internal::Judge;
using internal::LinePoint;
using internal::Measure;
using internal::RobustQuadratic;

constexpr double kUnseen = std::numeric_limits<double>::quiet_NaN();

// A pixel has a colour if one channel exceeds both others by this fraction of the gauze's
// brightness, which makes the segmentation independent of the light.
constexpr double kColorShare = 0.15;
// Same as kColorShare, for the line: about half of the line's excess of red. Larger than
// kColorShare because a column's sum includes many pixels of gauze, whose noise must not count.
constexpr double kLineShare = 0.3;
constexpr double kGoodMarkErrorPx = 0.15;  // RMS; sub-pixel centres of whole marks fit within 0.1
constexpr double kMaxMarkErrorPx = 0.6;
constexpr double kMaxLineErrorM = 2.5e-4;  // RMS over the accepted columns
constexpr double kMinLineLengthM = 0.015;
constexpr double kMaxBeyondLineM = 0.002;  // maximum distance of the tip beyond the line's ends
constexpr int kMinColumns = 50;

double SmallestDistance(const std::vector<Eigen::Vector2d>& points) {
  double smallest = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < points.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      smallest = std::min(smallest, (points[i] - points[j]).norm());
    }
  }
  return smallest;
}

Eigen::Vector3d On(const Eigen::Vector2d& p) noexcept { return {p.x(), p.y(), 0.0}; }

// Collinear marks do not determine the rotation about their line.
bool OnOneLine(const std::vector<internal::MarkSighting>& sightings) noexcept {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const auto& s : sightings) mean += s.on_target.head<2>();
  mean /= static_cast<double>(sightings.size());
  Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();
  for (const auto& s : sightings) {
    const Eigen::Vector2d d = s.on_target.head<2>() - mean;
    scatter += d * d.transpose();
  }
  // If the eigenvalues differ greatly, determinant / trace^2 approximates their ratio.
  const double trace = scatter.trace();
  return !(scatter.determinant() > 0.01 * trace * trace);
}

}  // namespace

const char* Name(NotSeen reason) noexcept {
  switch (reason) {
    case NotSeen::kNothing:
      return "seen";
    case NotSeen::kWrongSize:
      return "wrong-size";
    case NotSeen::kDark:
      return "dark";
    case NotSeen::kOverexposed:
      return "overexposed";
    case NotSeen::kFrozen:
      return "frozen";
    case NotSeen::kTarget:
      return "target";
    case NotSeen::kForeignCamera:
      return "foreign-camera";
    case NotSeen::kLine:
      return "line";
    case NotSeen::kTip:
      return "tip";
    case NotSeen::kFault:
      return "fault";
  }
  return "unknown";
}

struct LineVision::Impl : internal::ColourBlobs {
  CameraModel camera;
  LineVisionOptions options;
  std::vector<Eigen::Vector2d> mark_pixels;  // expected position of each mark
  double mark_gate = 0.0;                    // maximum distance from these positions, px
  std::vector<double> mark_distance;
  double mark_area = 0.0;  // expected area of a mark, px^2
  double tip_area = 0.0;
  std::vector<Eigen::Vector2d> marks;
  std::vector<internal::MarkSighting> sightings;
  std::vector<int> weight;  // per image column: sums of the excess times 1, y and y^2
  std::vector<int> weighted_y;
  std::vector<double> weighted_y2;
  std::vector<int> sorted;
  std::vector<LinePoint> points;
  std::vector<double> point_weights;
  std::uint64_t last_hash = 0;
  bool has_last = false;

  // Writes NaN for marks that are not seen; returns the number seen.
  int MatchMarks(double threshold) {
    const double max_area = 1.6 * mark_area;
    Excess(0);
    FindBlobs(threshold, max_area);
    marks.assign(mark_pixels.size(), Eigen::Vector2d(kUnseen, kUnseen));
    // A blob is assigned to the mark with the nearest expected position. A motion of the target by
    // less than half the distance between two marks cannot confuse them.
    mark_distance.assign(mark_pixels.size(), mark_gate);
    int found = 0;
    for (const Blob& blob : blobs) {
      if (!blob.round || blob.area < 0.6 * mark_area || blob.area > max_area) continue;
      std::size_t nearest = 0;
      for (std::size_t i = 1; i < mark_pixels.size(); ++i) {
        if ((blob.center - mark_pixels[i]).norm() < (blob.center - mark_pixels[nearest]).norm()) {
          nearest = i;
        }
      }
      const double distance = (blob.center - mark_pixels[nearest]).norm();
      if (distance >= mark_distance[nearest]) continue;
      if (mark_distance[nearest] == mark_gate) ++found;
      mark_distance[nearest] = distance;
      marks[nearest] = blob.center;
    }
    return found;
  }

  bool MatchTip(double threshold, Blob& tip) {
    const double max_area = 2.0 * tip_area;
    Excess(1);
    FindBlobs(threshold, max_area);
    bool found = false;
    for (const Blob& blob : blobs) {
      if (blob.area < 0.5 * tip_area || blob.area > max_area || !blob.round) continue;
      if (found) return false;  // two candidates: ambiguous
      tip = blob;
      found = true;
    }
    return found;
  }

  // Computes sums over each column of [x0, x1) within rows [y0, y1).
  void SumColumns(int x0, int y0, int x1, int y1, int threshold) {
    const auto columns = static_cast<std::size_t>(excess.cols);
    weight.assign(columns, 0);
    weighted_y.assign(columns, 0);
    weighted_y2.assign(columns, 0.0);
    for (int y = y0; y < y1; ++y) {
      const std::uint8_t* p = excess.ptr<std::uint8_t>(y);
      for (int x = x0; x < x1; ++x) {
        const int w = std::max(0, static_cast<int>(p[x]) - threshold);
        if (w == 0) continue;
        const auto i = static_cast<std::size_t>(x);
        weight[i] += w;
        weighted_y[i] += w * y;
        weighted_y2[i] += static_cast<double>(w) * y * y;
      }
    }
  }

  // Position of the tip, and the smaller of its area / expected area and the reciprocal.
  struct Tip {
    Eigen::Vector3d p_cam;
    double share;
  };
  // Line on the target, and the fraction of the collected points that fit it.
  struct Line {
    RobustQuadratic curve;
    double share;
  };

  NotSeen LocateTarget(double threshold, LineObservation& seen);
  NotSeen LocateTip(double threshold, const Eigen::Hyperplane<double, 3>& plane,
                    LineObservation& seen, Tip& tip);
  NotSeen CollectLinePoints(double threshold, const Eigen::Isometry3d& pose);
  NotSeen FitLine(LineObservation& seen, Line& line);
};

// Estimates the gauze's plane from the marks.
NotSeen LineVision::Impl::LocateTarget(double threshold, LineObservation& seen) {
  if (MatchMarks(threshold) < 4) return NotSeen::kTarget;
  sightings.clear();
  for (std::size_t i = 0; i < marks.size(); ++i) {
    if (!marks[i].allFinite()) continue;
    const Eigen::Vector2d normalized = camera.ToNormalized(marks[i]);
    if (!normalized.allFinite()) return NotSeen::kForeignCamera;
    sightings.push_back({On(options.target.marks_m[i]), normalized});
  }
  if (OnOneLine(sightings)) return NotSeen::kTarget;
  Eigen::Isometry3d pose = options.p_cam_target;
  seen.mark_error_px = camera.fx * internal::RefinePose(sightings, pose);
  // A mark partly hidden by the tool is displaced: exclude the marks that fit worst, at most two.
  for (int left_out = 0;
       left_out < 2 && sightings.size() > 4 && !(seen.mark_error_px < kGoodMarkErrorPx);
       ++left_out) {
    const auto error = [&pose](const internal::MarkSighting& sighting) {
      const Eigen::Vector3d p = pose * sighting.on_target;
      return (p.head<2>() / p.z() - sighting.normalized).squaredNorm();
    };
    sightings.erase(
        std::max_element(sightings.begin(), sightings.end(),
                         [&error](const auto& a, const auto& b) { return error(a) < error(b); }));
    if (OnOneLine(sightings)) return NotSeen::kTarget;
    pose = options.p_cam_target;
    seen.mark_error_px = camera.fx * internal::RefinePose(sightings, pose);
  }
  if (!(seen.mark_error_px < kMaxMarkErrorPx) ||
      (pose.translation() - options.p_cam_target.translation()).norm() > options.max_motion_m) {
    return NotSeen::kForeignCamera;
  }
  seen.p_cam_target = pose;
  return NotSeen::kNothing;
}

NotSeen LineVision::Impl::LocateTip(double threshold, const Eigen::Hyperplane<double, 3>& plane,
                                    LineObservation& seen, Tip& tip) {
  Blob blob;
  if (!MatchTip(threshold, blob)) return NotSeen::kTip;
  seen.tip_pixel = blob.center;
  const Eigen::Vector2d normalized = camera.ToNormalized(blob.center);
  const Eigen::Vector3d ray(normalized.x(), normalized.y(), 1.0);
  const double depth = -plane.offset() / plane.normal().dot(ray);
  if (!(depth > 0.0) || !std::isfinite(depth)) return NotSeen::kTip;
  tip.p_cam = depth * ray;
  tip.share = std::min(blob.area / tip_area, tip_area / blob.area);
  return NotSeen::kNothing;
}

// Collects the centre of the red run in every image column between the marks, in the target's
// frame.
NotSeen LineVision::Impl::CollectLinePoints(double threshold, const Eigen::Isometry3d& pose) {
  double left = camera.width;
  double right = 0.0;
  double top = camera.height;
  double bottom = 0.0;
  for (const Eigen::Vector2d& mark : options.target.marks_m) {
    const Eigen::Vector2d p = camera.Project(pose * On(mark));
    left = std::min(left, p.x());
    right = std::max(right, p.x());
    top = std::min(top, p.y());
    bottom = std::max(bottom, p.y());
  }
  if (!std::isfinite(left + right + top + bottom)) return NotSeen::kTarget;
  const int x0 = static_cast<int>(std::clamp(left, 0.0, camera.width - 1.0));
  const int x1 = static_cast<int>(std::clamp(right, 0.0, static_cast<double>(camera.width)));
  const int y0 = static_cast<int>(std::clamp(top, 0.0, camera.height - 1.0));
  const int y1 = static_cast<int>(std::clamp(bottom, 0.0, static_cast<double>(camera.height)));
  Excess(2);
  SumColumns(x0, y0, x1, y1, static_cast<int>(threshold));
  sorted.clear();
  for (int x = x0; x < x1; ++x) {
    const int w = weight[static_cast<std::size_t>(x)];
    if (w > threshold) sorted.push_back(w);
  }
  if (sorted.size() < static_cast<std::size_t>(kMinColumns)) return NotSeen::kLine;
  const double median = core::Median(sorted);
  const double width_px = options.target.line_width_m * camera.fx / pose.translation().z();
  const Eigen::Vector3d normal = pose.linear().col(2);
  const double plane_distance = normal.dot(pose.translation());
  points.clear();
  for (int x = x0; x < x1; ++x) {
    const auto i = static_cast<std::size_t>(x);
    const double w = weight[i];
    // A column partly hidden by the tool has a displaced centre: skip it.
    if (w < 0.7 * median || w > 1.5 * median) continue;
    const double y = weighted_y[i] / w;
    const double variance = weighted_y2[i] / w - y * y;
    if (variance > width_px * width_px + 4.0) continue;  // two runs
    const Eigen::Vector2d n = camera.ToNormalized({static_cast<double>(x), y});
    if (!n.allFinite()) continue;
    const Eigen::Vector3d r(n.x(), n.y(), 1.0);
    const Eigen::Vector3d p = pose.inverse() * Eigen::Vector3d(plane_distance / normal.dot(r) * r);
    points.push_back({p.x(), p.y()});
  }
  return points.size() < static_cast<std::size_t>(kMinColumns) ? NotSeen::kLine : NotSeen::kNothing;
}

NotSeen LineVision::Impl::FitLine(LineObservation& seen, Line& line) {
  if (!line.curve.Fit(points, point_weights)) return NotSeen::kLine;
  double squared = 0.0;
  double inliers = 0.0;
  seen.x_min = std::numeric_limits<double>::infinity();
  seen.x_max = -seen.x_min;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (point_weights[i] == 0.0) continue;
    const double error = points[i].y - line.curve.At(points[i].x);
    squared += error * error;
    inliers += 1.0;
    seen.x_min = std::min(seen.x_min, points[i].x);
    seen.x_max = std::max(seen.x_max, points[i].x);
  }
  line.share = inliers / static_cast<double>(points.size());
  seen.line = line.curve.coefficients();
  seen.line_error_m = inliers > 0 ? std::sqrt(squared / inliers) : kUnseen;
  const bool good = inliers >= kMinColumns && !(seen.x_max - seen.x_min < kMinLineLengthM) &&
                    seen.line_error_m < kMaxLineErrorM;
  return good ? NotSeen::kNothing : NotSeen::kLine;
}

LineVision::LineVision(const CameraModel& camera, const LineVisionOptions& options)
    : impl_(std::make_unique<Impl>()) {
  camera.Check();
  impl_->camera = camera;
  impl_->options = options;
  const LineTarget& target = options.target;
  DFR_THROW_UNLESS(
      target.marks_m.size() >= 4,
      "line vision: the gauze's frame needs at least 4 marks, not " << target.marks_m.size());
  DFR_THROW_UNLESS(target.mark_radius_m > 0 && target.line_width_m > 0 && target.tip_radius_m > 0,
                   "line vision: mark_radius_m, line_width_m and tip_radius_m must be positive");
  DFR_THROW_UNLESS(options.max_motion_m > 0,
                   "line vision: max_motion_m must be positive, not " << options.max_motion_m);
  DFR_THROW_UNLESS(
      options.min_confidence >= 0 && options.min_confidence <= 1,
      "line vision: min_confidence must lie in [0, 1], not " << options.min_confidence);
  for (const Eigen::Vector2d& mark : target.marks_m) {
    impl_->mark_pixels.push_back(camera.Project(options.p_cam_target * On(mark)));
    DFR_THROW_UNLESS(impl_->mark_pixels.back().allFinite(),
                     "line vision: p_cam_target puts a mark behind the camera");
  }
  DFR_THROW_UNLESS(SmallestDistance(impl_->mark_pixels) > 10.0,
                   "line vision: two marks are less than 10 pixels apart");
  const double scale = camera.fx / options.p_cam_target.translation().z();  // px per m
  impl_->mark_gate = options.max_motion_m * scale;
  constexpr double kPi = 3.14159265358979323846;
  impl_->mark_area = kPi * std::pow(target.mark_radius_m * scale, 2);
  impl_->tip_area = kPi * std::pow(target.tip_radius_m * scale, 2);
}

LineVision::~LineVision() = default;
LineVision::LineVision(LineVision&&) noexcept = default;
LineVision& LineVision::operator=(LineVision&&) noexcept = default;

void LineVision::ForgetLastImage() noexcept { impl_->has_last = false; }

Eigen::Vector2d LineVision::FindTip(const ImageView& image) noexcept try {
  if (image.width != impl_->camera.width || image.height != impl_->camera.height)
    return {kUnseen, kUnseen};
  const Exposure exposure = Measure(image);
  if (Judge(exposure) != NotSeen::kNothing) return {kUnseen, kUnseen};
  impl_->Split(image);
  Blob tip;
  if (!impl_->MatchTip(kColorShare * exposure.brightness, tip)) return {kUnseen, kUnseen};
  return tip.center;
} catch (const std::exception&) {
  return {kUnseen, kUnseen};
}

bool LineVision::FindMarks(const ImageView& image, std::vector<Eigen::Vector2d>& marks) noexcept
    try {
  if (image.width != impl_->camera.width || image.height != impl_->camera.height) return false;
  const Exposure exposure = Measure(image);
  if (Judge(exposure) != NotSeen::kNothing) return false;
  impl_->Split(image);
  const int found = impl_->MatchMarks(kColorShare * exposure.brightness);
  marks = impl_->marks;
  return found >= 4;
} catch (const std::exception&) {
  return false;
}

LineObservation LineVision::Observe(const ImageView& image,
                                    const Eigen::Hyperplane<double, 3>& tip_plane_cam) noexcept
    try {
  Impl& m = *impl_;
  LineObservation seen;
  const auto missing = [&seen](NotSeen reason) {
    seen.missing = reason;
    return seen;
  };
  if (image.width != m.camera.width || image.height != m.camera.height) {
    return missing(NotSeen::kWrongSize);
  }
  const Exposure exposure = Measure(image);
  const bool frozen = m.has_last && exposure.hash == m.last_hash;
  m.last_hash = exposure.hash;
  m.has_last = true;
  if (const NotSeen reason = Judge(exposure); reason != NotSeen::kNothing) return missing(reason);
  if (frozen) return missing(NotSeen::kFrozen);
  const double threshold = kColorShare * exposure.brightness;
  m.Split(image);

  NotSeen reason = m.LocateTarget(threshold, seen);
  if (reason != NotSeen::kNothing) return missing(reason);
  Impl::Tip tip;
  reason = m.LocateTip(threshold, tip_plane_cam, seen, tip);
  if (reason != NotSeen::kNothing) return missing(reason);
  reason = m.CollectLinePoints(kLineShare * exposure.brightness, seen.p_cam_target);
  if (reason != NotSeen::kNothing) return missing(reason);
  Impl::Line line;
  reason = m.FitLine(seen, line);
  if (reason != NotSeen::kNothing) return missing(reason);

  const Eigen::Isometry3d& pose = seen.p_cam_target;
  const Eigen::Vector3d tip_on_target = pose.inverse() * tip.p_cam;
  const double x = line.curve.Nearest({tip_on_target.x(), tip_on_target.y()});
  if (!(x > seen.x_min - kMaxBeyondLineM && x < seen.x_max + kMaxBeyondLineM)) {
    return missing(NotSeen::kLine);
  }
  const double slope = line.curve.SlopeAt(x);
  const double length = std::sqrt(1.0 + slope * slope);
  const double distance =
      ((tip_on_target.y() - line.curve.At(x)) - slope * (tip_on_target.x() - x)) / length;

  const double mark_share =
      static_cast<double>(m.sightings.size()) / static_cast<double>(m.marks.size());
  seen.confidence = std::min({mark_share, line.share, tip.share});
  const double least = m.options.min_confidence;
  if (seen.confidence < least) {
    return missing(tip.share < least    ? NotSeen::kTip
                   : line.share < least ? NotSeen::kLine
                                        : NotSeen::kTarget);
  }
  seen.distance_m = distance;
  seen.p_cam_tip = tip.p_cam;
  seen.tangent_cam = pose.linear() * Eigen::Vector3d(1.0 / length, slope / length, 0.0);
  seen.missing = NotSeen::kNothing;
  return seen;
} catch (const std::exception&) {
  LineObservation failed;
  failed.missing = NotSeen::kFault;
  return failed;
}

}  // namespace dfr::vision
