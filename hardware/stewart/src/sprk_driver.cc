#include "dfr/hardware/sprk_driver.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <thread>

#include "dfr/core/error.h"

namespace dfr::hardware {
namespace {

using kinematics::PlatformPose;

double SteadySeconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

void Sleep(double seconds) { std::this_thread::sleep_for(std::chrono::duration<double>(seconds)); }

const char* OpenRemedy(int error) {
  switch (error) {
    case ENOENT:
    case ENXIO:
    case ENODEV:
      return "check that the platform is plugged in and powered; `ls /dev/ttyACM* /dev/ttyUSB*` "
             "shows the serial ports";
    case EACCES:
    case EPERM:
      return "add the user to the port's group (`sudo adduser $USER dialout`) and log in again";
    case EBUSY:
      return "another program has the port open; `fuser` names it";
    default:
      return "";
  }
}

[[noreturn]] void Fail(int fd, const std::string& device, const std::string& what, int error,
                       const char* remedy) {
  if (fd >= 0) ::close(fd);
  throw core::Error(device + ": " + what + ": " + std::strerror(error), remedy);
}

int OpenPort(const std::string& device) {
  const int fd = ::open(device.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
  if (fd < 0) Fail(fd, device, "cannot be opened", errno, OpenRemedy(errno));
  termios port{};
  if (::tcgetattr(fd, &port) != 0) {
    Fail(fd, device, "is not a serial port", errno,
         "give the platform's port, /dev/ttyACM0 for example");
  }
  // Root can open a port that another process has claimed exclusively. The driver refuses such a
  // port.
  int claimed = 0;
  if (::ioctl(fd, TIOCGEXCL, &claimed) == 0 && claimed != 0) {
    Fail(fd, device, "cannot be opened", EBUSY, OpenRemedy(EBUSY));
  }
  if (::ioctl(fd, TIOCEXCL) != 0) Fail(fd, device, "cannot be claimed", errno, "");
  ::cfmakeraw(&port);
  ::cfsetspeed(&port, B57600);
  port.c_cflag &= ~static_cast<tcflag_t>(CSTOPB | CRTSCTS | HUPCL);
  port.c_cflag |= CLOCAL | CREAD;
  termios set{};
  // tcsetattr() succeeds if it could apply any of the settings.
  if (::tcsetattr(fd, TCSANOW, &port) != 0 || ::tcgetattr(fd, &set) != 0) {
    Fail(fd, device, "cannot be set to 57600 8N1", errno, "");
  }
  constexpr tcflag_t kShape = CSIZE | CSTOPB | PARENB | CRTSCTS;
  if (::cfgetospeed(&set) != B57600 || (set.c_cflag & kShape) != (port.c_cflag & kShape) ||
      (set.c_oflag & OPOST) != 0) {
    Fail(fd, device, "does not accept 57600 8N1", EINVAL, "check that this is the platform's port");
  }
  ::tcflush(fd, TCIOFLUSH);
  return fd;
}

}  // namespace

SprkDriver::SprkDriver(const SprkOptions& options)
    : clock_s_(options.clock_s ? options.clock_s : SteadySeconds),
      wait_s_(options.wait_s ? options.wait_s : Sleep),
      fd_(OpenPort(options.device)) {}

SprkDriver::~SprkDriver() {
  ::ioctl(fd_, TIOCNXCL);
  ::close(fd_);
}

SprkStatus SprkDriver::Ready() const noexcept {
  if (failed_) return SprkStatus::kDeviceFailed;
  if (!homed_) return SprkStatus::kNotHomed;
  if (sent_ && clock_s_() - sent_s_ < kSprkFramePeriod) return SprkStatus::kTooSoon;
  return SprkStatus::kOk;
}

void SprkDriver::AwaitFrame() const noexcept {
  if (!sent_) return;
  const double wait_s = kSprkFramePeriod - (clock_s_() - sent_s_);
  if (wait_s > 0.0) wait_s_(wait_s);
}

SprkStatus SprkDriver::Send(std::span<const char> frame) noexcept {
  // Discards the firmware's output, which would fill the kernel's buffer.
  ::tcflush(fd_, TCIFLUSH);
  ssize_t written = 0;
  do {
    written = ::write(fd_, frame.data(), frame.size());
  } while (written < 0 && errno == EINTR);
  // The firmware treats the start of a frame as the whole frame. After a partial write the
  // platform's motion is unknown.
  if (written != static_cast<ssize_t>(frame.size())) {
    failed_ = true;
    return SprkStatus::kDeviceFailed;
  }
  sent_ = true;
  sent_s_ = clock_s_();
  return SprkStatus::kOk;
}

SprkStatus SprkDriver::Home() noexcept {
  if (failed_) return SprkStatus::kDeviceFailed;
  AwaitFrame();
  const SprkStatus status = Send(std::span<const char>("h", 1));
  if (status != SprkStatus::kOk) return status;
  if (homed_) {
    lag_.Command({}, sent_s_);
  } else {
    lag_.Rest({}, sent_s_);
    goes_home_ = true;
    home_s_ = sent_s_;
  }
  homed_ = true;
  return SprkStatus::kOk;
}

SprkStatus SprkDriver::MoveTo(const PlatformPose& pose) noexcept {
  SprkStatus status = Ready();
  if (status != SprkStatus::kOk) return status;
  SprkPositionFrame frame{};
  PlatformPose sent;
  status = EncodeSprkPosition(pose, frame, sent);
  if (status != SprkStatus::kOk) return status;
  status = Send(frame);
  if (status != SprkStatus::kOk) return status;
  lag_.Command(sent, sent_s_);
  goes_home_ = false;
  return SprkStatus::kOk;
}

SprkStatus SprkDriver::Start(SprkWaveKind kind, const SprkWave& wave) noexcept {
  SprkStatus status = Ready();
  if (status != SprkStatus::kOk) return status;
  SprkWaveFrame frame{};
  SprkWave sent;
  status = EncodeSprkWave(kind, wave, frame, sent);
  if (status != SprkStatus::kOk) return status;
  status = Send(frame);
  if (status != SprkStatus::kOk) return status;
  lag_.Command(SprkWaveMiddle(kind, sent.amplitude), sent_s_);
  goes_home_ = false;
  return SprkStatus::kOk;
}

SprkStatus SprkDriver::Hold() noexcept {
  if (failed_) return SprkStatus::kDeviceFailed;
  if (!homed_) return SprkStatus::kNotHomed;
  AwaitFrame();
  const PlatformPose here = lag_.At(clock_s_());
  SprkPositionFrame frame{};
  PlatformPose sent;
  // Rounding may move a pose slightly out of reach. Home is always reachable.
  for (int tenth = 10; tenth >= 0; --tenth) {
    const double share = 0.1 * tenth;
    const PlatformPose near{share * here.translation_m, share * here.angles_rad};
    if (EncodeSprkPosition(near, frame, sent) == SprkStatus::kOk) break;
  }
  const SprkStatus status = Send(frame);
  if (status != SprkStatus::kOk) return status;
  lag_.Command(sent, sent_s_);
  goes_home_ = goes_home_ && sent_s_ - home_s_ < kHomeTime;
  return goes_home_ ? SprkStatus::kGoesHome : SprkStatus::kOk;
}

SprkStatus SprkDriver::Check() noexcept {
  pollfd port{fd_, 0, 0};
  if (!failed_ && ::poll(&port, 1, 0) > 0) failed_ = true;  // an unplugged port is hung up
  return failed_ ? SprkStatus::kDeviceFailed : SprkStatus::kOk;
}

}  // namespace dfr::hardware
