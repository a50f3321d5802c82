// Arbitrary poses and waves: the firmware decodes an encoded pose in reach to the reported value.
// Other poses and waves are rejected.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <string_view>

#include "dfr/hardware/sprk_protocol.h"
#include "tests/fuzz/target.h"
#include "tests/hardware_stewart/sprk_firmware.h"

namespace {

using dfr::kinematics::PlatformPose;

constexpr std::size_t kEntries = 12;

std::array<double, kEntries> Entries(const std::uint8_t* data, std::size_t size, bool small) {
  std::array<double, kEntries> numbers{};
  if (small) {
    // Few doubles have the magnitude of a platform's motion.
    for (std::size_t i = 0; i < std::min(kEntries, size); ++i) numbers[i] = (data[i] - 128) / 8e3;
  } else if (size > 0) {
    std::memcpy(numbers.data(), data, std::min(size, sizeof numbers));
  }
  return numbers;
}

bool Near(const PlatformPose& a, const PlatformPose& b) {
  return (a.translation_m - b.translation_m).norm() < 1e-9 &&
         (a.angles_rad - b.angles_rad).norm() < 1e-9;
}

void Expect(bool holds) {
  if (!holds) std::abort();
}

}  // namespace

DFR_FUZZ_TARGET(sprk) {
  using namespace dfr::hardware;
  if (size == 0) return 0;
  const unsigned kind = data[0];
  const auto numbers = Entries(data + 1, size - 1, (kind & 1U) != 0);
  const PlatformPose pose{{numbers[0], numbers[1], numbers[2]},
                          {10.0 * numbers[3], 10.0 * numbers[4], 10.0 * numbers[5]}};
  dfr::test::SprkFirmware firmware;
  if ((kind & 2U) == 0) {
    SprkPositionFrame frame{};
    PlatformPose sent;
    if (EncodeSprkPosition(pose, frame, sent) != SprkStatus::kOk) return 0;
    firmware.Receive({frame.data(), frame.size()});
    Expect(firmware.commands().size() == 1);
    const auto& command = firmware.commands().front();
    Expect(command.whole && !command.saturated && Near(command.Pose(), sent));
    Expect((sent.translation_m - pose.translation_m).cwiseAbs().maxCoeff() < 1.28e-4);
    return 0;
  }
  SprkWave wave{.amplitude = pose};
  for (int k = 0; k < 6; ++k) wave.frequency_hz[k] = numbers[static_cast<std::size_t>(k) + 6] * 50;
  SprkWaveFrame frame{};
  SprkWave sent;
  const auto which = (kind & 4U) == 0 ? SprkWaveKind::kSine : SprkWaveKind::kBreath;
  if (EncodeSprkWave(which, wave, frame, sent) != SprkStatus::kOk) return 0;
  firmware.Receive({frame.data(), frame.size()});
  Expect(firmware.commands().size() == 1);
  const auto& command = firmware.commands().front();
  Expect(command.whole && !command.saturated && Near(command.Pose(), sent.amplitude));
  return 0;
}
