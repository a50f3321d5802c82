#include <stdexcept>

#include "dfr/hardware/endoscope.h"
#include "dfr/hardware/intrinsics_file.h"

// Succeeds if intrinsics survive a round trip and an absent camera is reported.
int main() try {
  dfr::vision::CameraModel camera;
  camera.fx = 612.25;
  dfr::hardware::WriteIntrinsics("consumer_camera.yaml", camera);
  if (!(dfr::hardware::ReadIntrinsics("consumer_camera.yaml") == camera)) return 1;
  (void)dfr::hardware::OpenVideo("/dev/no-such-camera", {});
  return 2;
} catch (const std::runtime_error&) {
  return 0;
}
