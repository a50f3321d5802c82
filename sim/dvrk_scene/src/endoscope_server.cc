#include "endoscope_server.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <stdexcept>
#include <string_view>
#include <utility>

namespace dfr::sim::internal {
namespace {

using Clock = std::chrono::steady_clock;

dds::CameraInfo Info(const vision::CameraModel& camera) {
  dds::CameraInfo info;
  info.width = static_cast<std::uint32_t>(camera.width);
  info.height = static_cast<std::uint32_t>(camera.height);
  info.distortion_model = "plumb_bob";
  info.d.assign(camera.distortion.begin(), camera.distortion.end());
  info.k = {camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0};
  info.r = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
  info.p = {camera.fx, 0.0, camera.cx, 0.0, 0.0, camera.fy, camera.cy, 0.0, 0.0, 0.0, 1.0, 0.0};
  return info;
}

}  // namespace

EndoscopeServer::EndoscopeServer(dds::Participant& participant, const DvrkScene& scene,
                                 const Options& options)
    : options_(options),
      scene_(&scene),
      raw_(participant, "/" + options.name + "/image_raw", dds::Role::kImage),
      compressed_(participant, "/" + options.name + "/image_raw/compressed", dds::Role::kImage),
      info_(participant, "/" + options.name + "/camera_info", dds::Role::kState),
      encoder_(options.jpeg_quality),
      camera_info_(Info(scene.plant().calibration().camera)) {
  const vision::CameraModel& camera = scene.plant().endoscope().camera();
  image_.frame_id = jpeg_.frame_id = camera_info_.frame_id = options_.name;
  image_.encoding = "bgr8";
  image_.width = static_cast<std::uint32_t>(camera.width);
  image_.height = static_cast<std::uint32_t>(camera.height);
  image_.step = 3 * image_.width;
  image_.data.resize(scene.plant().endoscope().image_size());
  jpeg_.format = "bgr8; jpeg compressed bgr8";  // as in image_transport
  if (!options_.real_time) return;
  thread_ = std::thread([this] { Run(); });
  ready_.wait(false);
  if (!failed_) return;
  thread_.join();
  std::rethrow_exception(failure_);
}

EndoscopeServer::~EndoscopeServer() {
  if (!thread_.joinable()) return;
  hand_ = Hand::kStopped;
  hand_.notify_all();
  thread_.join();
}

bool EndoscopeServer::Watched() const noexcept {
  return raw_.num_subscribers() > 0 || compressed_.num_subscribers() > 0 ||
         info_.num_subscribers() > 0;
}

void EndoscopeServer::Take(const LineTrackingPlant& plant, const dds::Stamp& stamp, bool restart,
                           bool frozen) {
  if (restart) number_ = 0;
  if (!frozen) plant.RenderPicture(++number_, image_.data);
  if (silent_) return;
  Spoil();
  image_.stamp = jpeg_.stamp = camera_info_.stamp = stamp;
  raw_.Write(image_);
  info_.Write(camera_info_);
  if (compressed_.num_subscribers() > 0) {
    const std::string_view file = encoder_.Encode({.format = recording::PictureFormat::kBgr8,
                                                   .width = static_cast<int>(image_.width),
                                                   .height = static_cast<int>(image_.height),
                                                   .step = static_cast<int>(image_.step),
                                                   .data = image_.data});
    if (file.empty()) throw std::runtime_error("libjpeg-turbo cannot compress the picture");
    jpeg_.data.assign(file.begin(), file.end());
    compressed_.Write(jpeg_);
  }
  ++published_;
}

void EndoscopeServer::Spoil() {
  if (late_) {
    delayed_.push_back(image_.data);
    const auto second = static_cast<std::size_t>(std::max(1.0, std::ceil(1.0 / options_.period_s)));
    while (delayed_.size() > second) delayed_.pop_front();
    image_.data = delayed_.front();
  } else {
    delayed_.clear();
  }
  if (!noisy_) return;
  for (std::uint8_t& value : image_.data) {
    noise_ ^= noise_ << 13U;
    noise_ ^= noise_ >> 17U;
    noise_ ^= noise_ << 5U;
    if ((noise_ & 3U) == 0) value ^= 1U;
  }
}

void EndoscopeServer::Look(const dds::Stamp& stamp) {
  Take(scene_->plant(), stamp, std::exchange(restart_, false),
       scene_->camera_fault() == CameraFault::kFrozen);
}

void EndoscopeServer::Offer(const std::function<dds::Stamp()>& clock) {
  if (failed_) std::rethrow_exception(failure_);
  if (hand_ != Hand::kWanted) return;
  copy_->CopyStateFrom(scene_->plant());
  copy_stamp_ = clock();
  copy_restart_ = std::exchange(restart_, false);
  copy_frozen_ = scene_->camera_fault() == CameraFault::kFrozen;
  Hand wanted = Hand::kWanted;
  if (hand_.compare_exchange_strong(wanted, Hand::kFilled)) hand_.notify_all();
}

void EndoscopeServer::Run() {
  try {
    // Clones the plant here, because a rendering object belongs to one thread. The constructor
    // waits until the clone is ready.
    copy_.reset(static_cast<LineTrackingPlant*>(scene_->plant().Clone().release()));
    copy_->RenderPicture(0, image_.data);
    ready_ = true;
    ready_.notify_all();
    const auto period = std::chrono::duration_cast<Clock::duration>(
        std::chrono::duration<double>(options_.period_s));
    for (auto next = Clock::now(); hand_ != Hand::kStopped;) {
      // If the machine falls behind, continues from here instead of catching up.
      next = std::max(next + period, Clock::now());
      std::this_thread::sleep_until(next);
      if (silent_ || !Watched()) continue;
      Hand idle = Hand::kIdle;
      if (!hand_.compare_exchange_strong(idle, Hand::kWanted)) break;
      hand_.wait(Hand::kWanted);
      if (hand_ != Hand::kFilled) break;
      Take(*copy_, copy_stamp_, copy_restart_, copy_frozen_);
      Hand filled = Hand::kFilled;
      if (!hand_.compare_exchange_strong(filled, Hand::kIdle)) break;
    }
  } catch (...) {
    failure_ = std::current_exception();
    failed_ = true;
    hand_ = Hand::kStopped;
    hand_.notify_all();
    ready_ = true;
    ready_.notify_all();
  }
  copy_.reset();
}

}  // namespace dfr::sim::internal
