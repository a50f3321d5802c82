#include "tests/hardware_stewart/sprk_firmware.h"

#include <cmath>

namespace dfr::test {
namespace {

constexpr double kPi = 3.14159265358979323846;

// The available bytes. The firmware reads -1 after the last byte.
class Bytes {
 public:
  explicit Bytes(std::string_view bytes) : bytes_(bytes) {}
  [[nodiscard]] bool empty() const { return next_ == bytes_.size(); }
  [[nodiscard]] bool ran_out() const { return ran_out_; }
  int Read() {
    if (!empty()) return bytes_[next_++];
    ran_out_ = true;
    return -1;
  }
  int TwoDigits() {
    const int units = Read() - '0';
    return units + 10 * (Read() - '0');
  }

 private:
  std::string_view bytes_;
  std::size_t next_ = 0;
  bool ran_out_ = false;
};

double Decode(int number, int k) { return k < 3 ? number / 100.0 - 0.5 : number - 15.0; }

kinematics::PlatformPose ToPose(const Eigen::Matrix<double, 6, 1>& v) {
  kinematics::PlatformPose pose;
  pose.translation_m = 0.0254 * v.head<3>();
  pose.angles_rad = kPi / 180.0 * Eigen::Vector3d(v[3], -v[4], -v[5]);
  return pose;
}

}  // namespace

kinematics::PlatformPose SprkFirmware::Command::Pose() const { return ToPose(values); }

kinematics::PlatformPose SprkFirmware::Command::PoseAt(double time_s) const {
  Eigen::Matrix<double, 6, 1> v = values;
  for (int k = 0; k < 6 && letter != 'a' && letter != 'h'; ++k) {
    const double phase = rad_per_s[k] * time_s;
    // The breath has the range [0, 2 A] for positions, and [-A, A] for angles.
    v[k] *= letter == 'c' ? std::sin(phase) : (k < 3 ? 1.0 : 0.0) - std::cos(phase);
  }
  return ToPose(v);
}

void SprkFirmware::Receive(std::string_view bytes) {
  Bytes input(bytes);
  while (!input.empty()) {
    Command command;
    command.letter = static_cast<char>(input.Read());
    const bool wave = command.letter == 'c' || command.letter == 'd';
    if (command.letter != 'h' && command.letter != 'a' && !wave) continue;
    for (int k = 0; k < 6 && command.letter != 'h'; ++k) {
      command.values[k] = Decode(input.TwoDigits(), k);
      if (wave) {
        const double unit = command.letter == 'c' ? 2.0 * kPi : 1.0;
        command.rad_per_s[k] = unit * input.TwoDigits() / 100.0;
      }
    }
    command.whole = !input.ran_out();
    for (int i = 0; i <= (wave ? 2000 : 0); ++i) {
      command.saturated =
          command.saturated || !kinematics::SprkPlatform::FirmwareReaches(command.PoseAt(0.05 * i));
    }
    commands_.push_back(command);
  }
}

}  // namespace dfr::test
