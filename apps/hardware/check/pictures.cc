#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "check/check.h"
#include "check/findings.h"
#include "dfr/core/error.h"
#include "dfr/core/numerics/quantile.h"
#include "dfr/hardware/endoscope.h"
#include "dfr/hardware/intrinsics_file.h"

namespace dfr::apps::hardware_app {
namespace {

using hardware::FrameStatus;

// Pictures received from an endoscope during a check.
struct Pictures {
  std::array<int, static_cast<std::size_t>(FrameStatus::kFrozen) + 1> times{};  // by FrameStatus
  std::vector<double> ages;                                                     // s
  std::uint64_t received = 0;
  std::uint64_t lost = 0;
  double rate = 0.0;      // 1/s
  hardware::Frame frame;  // the last one

  [[nodiscard]] int good() const noexcept { return times[0]; }
};

Pictures ReceivePictures(const CheckOptions& options, hardware::Endoscope& endoscope) {
  Pictures pictures;
  hardware::Frame& frame = pictures.frame;
  Clock& clock = *options.clock;
  const auto grab = [&] { return endoscope.Grab(clock.SteadyNs(), clock.WallNs(), frame); };
  (void)Within(clock, options.find_s,
               [&] { return grab() != FrameStatus::kNever || Interrupted(options); });
  const std::int64_t start_ns = clock.SteadyNs();
  const hardware::EndoscopeCounts before = endoscope.counts();
  std::uint64_t last = 0;
  (void)Within(clock, options.listen_s, [&] {
    const FrameStatus status = grab();
    ++pictures.times[static_cast<std::size_t>(status)];
    if (frame.sequence != last) pictures.ages.push_back(frame.age_s);
    last = frame.sequence;
    return status == FrameStatus::kEnded || status == FrameStatus::kTruncated ||
           status == FrameStatus::kFailed || Interrupted(options);
  });
  const hardware::EndoscopeCounts after = endoscope.counts();
  const double seconds = 1e-9 * static_cast<double>(clock.SteadyNs() - start_ns);
  pictures.received = after.received - before.received;
  pictures.lost = after.lost - before.lost;
  pictures.rate = static_cast<double>(pictures.received) / seconds;
  return pictures;
}

// Reports the number of good pictures and the most frequent error of bad pictures.
void ReportPictures(const CheckOptions& options, const hardware::EndoscopeOptions& camera,
                    const Pictures& pictures, DeviceReport& report) {
  const auto& [times, ages, received, lost, rate, frame] = pictures;
  const auto size = [](int width, int height) {
    return std::to_string(width) + " x " + std::to_string(height);
  };
  if (pictures.good() > 0) {
    Ok(report,
       Text(rate, 1) + " pictures a second of " + size(frame.width, frame.height) + " pixels");
  }
  const auto worst = std::max_element(times.begin() + 1, times.end());
  const int looks = std::max(1, *std::max_element(times.begin(), times.end()));
  const auto status = static_cast<FrameStatus>(worst - times.begin());
  const bool late = status == FrameStatus::kOld || status == FrameStatus::kSilent;
  if (*worst > 0 && status == FrameStatus::kEnded) {
    Note(report, hardware::Name(status), hardware::Remedy(status));
  } else if (late && 10 * *worst > looks && 2 * *worst <= looks) {
    Note(report, std::string("occasionally: ") + hardware::Name(status),
         "check the load of network and machine");
  } else if (10 * *worst > looks) {
    std::string what = hardware::Name(status);
    if (status == FrameStatus::kWrongSize) {
      what = "pictures have " + size(frame.width, frame.height) +
             " pixels, the intrinsics are for " + size(camera.width, camera.height);
    } else if (status == FrameStatus::kOld || status == FrameStatus::kAhead) {
      what += ": by " + Text(std::abs(frame.age_s), 3) + " s";
    } else if (status == FrameStatus::kNever) {
      what = "no program publishes pictures on " + options.endoscope;
    }
    Wrong(report, what, hardware::Remedy(status));
  }
}

}  // namespace

DeviceReport CheckEndoscope(const CheckOptions& options) {
  DeviceReport report;
  report.device = "endoscope " + options.endoscope;
  hardware::EndoscopeOptions camera;
  if (!options.camera.empty()) {
    try {
      const vision::CameraModel model = hardware::ReadIntrinsics(options.camera);
      camera.width = model.width;
      camera.height = model.height;
      Ok(report, "intrinsics for " + std::to_string(model.width) + " x " +
                     std::to_string(model.height) + " pixels, focal length " + Text(model.fx, 1) +
                     " x " + Text(model.fy, 1) + " pixels");
    } catch (const std::runtime_error& e) {
      Wrong(report, e.what(), "calibrate the camera; see docs/robot.md");
      return report;
    }
  }
  std::unique_ptr<dds::Participant> participant;
  std::unique_ptr<hardware::Endoscope> endoscope;
  Say(options, "looking at " + options.endoscope);
  try {
    if (hardware::IsImageTopic(options.endoscope)) {
      participant = std::make_unique<dds::Participant>(options.network);
      report.device += InNetwork(options);
      endoscope = hardware::OpenTopic(*participant, options.endoscope, camera);
    } else {
      endoscope = hardware::OpenVideo(options.endoscope, camera);
    }
  } catch (const core::Error& e) {
    Wrong(report, std::string(e.problem()), std::string(e.remedy()));
    return report;
  } catch (const std::runtime_error& e) {
    Wrong(report, e.what(), "");
    return report;
  }

  LookAt(options, camera, *endoscope, report);
  return report;
}

void LookAt(const CheckOptions& options, const hardware::EndoscopeOptions& camera,
            hardware::Endoscope& endoscope, DeviceReport& report) {
  Pictures pictures = ReceivePictures(options, endoscope);
  if (Interrupted(options)) {
    Wrong(report, "interrupted", "");
    return;
  }
  ReportPictures(options, camera, pictures, report);
  if (pictures.good() == 0 || pictures.ages.empty()) return;
  if (hardware::IsImageTopic(options.endoscope)) {
    Ok(report, "pictures are " + Text(1e3 * core::Median(pictures.ages), 1) + " ms old");
  }
  if (10 * pictures.lost > pictures.received) {
    Note(report, std::to_string(pictures.lost) + " pictures were lost",
         "check the load of network and machine, or send compressed pictures");
  }
}

}  // namespace dfr::apps::hardware_app
