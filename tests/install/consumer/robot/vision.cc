#include "dfr/vision/line_vision.h"

// Succeeds if the library reports that a picture has the wrong size.
int main() {
  dfr::vision::LineVisionOptions options;
  options.target.marks_m = {{-0.03, -0.02}, {0.03, -0.02}, {-0.03, 0.02}, {0.03, 0.02}};
  options.p_cam_target.translation().z() = 0.1;
  dfr::vision::LineVision vision({}, options);
  const auto seen = vision.Observe({}, {Eigen::Vector3d::UnitZ(), 0.1});
  return seen.missing == dfr::vision::NotSeen::kWrongSize ? 0 : 1;
}
