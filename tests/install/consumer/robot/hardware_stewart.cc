#include <string>

#include "dfr/hardware/sprk_driver.h"

// The frame for home, and an absent port.
int main() {
  dfr::hardware::SprkPositionFrame frame;
  dfr::kinematics::PlatformPose sent;
  if (dfr::hardware::EncodeSprkPosition({}, frame, sent) != dfr::hardware::SprkStatus::kOk)
    return 1;
  if (std::string(frame.begin(), frame.end()) != "a050505515151") return 1;
  try {
    const dfr::hardware::SprkDriver driver({.device = "/dev/no-such-port"});
  } catch (const std::runtime_error&) {
    return 0;
  }
  return 1;
}
