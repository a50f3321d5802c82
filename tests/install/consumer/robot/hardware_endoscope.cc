#include <fstream>
#include <stdexcept>

#include "dfr/hardware/endoscope.h"
#include "dfr/hardware/intrinsics_file.h"

// Succeeds if intrinsics are read and an absent camera is reported.
int main() try {
  std::ofstream("consumer_camera.yaml")
      << "image_width: 640\nimage_height: 480\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
         "  data: [612.25, 0, 320, 0, 612, 240, 0, 0, 1]\ndistortion_coefficients:\n  rows: 1\n"
         "  cols: 4\n  data: [0, 0, 0, 0]\n";
  if (dfr::hardware::ReadIntrinsics("consumer_camera.yaml").fx != 612.25) return 1;
  (void)dfr::hardware::OpenVideo("/dev/no-such-camera", {});
  return 2;
} catch (const std::runtime_error&) {
  return 0;
}
