#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <exception>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "dfr/dds/channel.h"
#include "dfr/recording/jpeg_encoder.h"
#include "dfr/sim/dvrk_scene/dvrk_scene.h"

namespace dfr::sim::internal {

/// Publisher of the endoscope's topics: image_raw, image_raw/compressed, camera_info.
///
/// In lock-step, Look() takes a picture on request. In real time, a separate thread draws a copy of
/// the scene, which the caller's thread passes in Offer() on demand. Neither thread waits for the
/// other: slow pictures do not delay the arm's state. Pictures are drawn only while there is a
/// subscriber.
class EndoscopeServer {
 public:
  struct Options {
    std::string name;
    double period_s = 0.0;
    int jpeg_quality = 0;
    bool real_time = false;
  };

  /// Borrows both arguments, which must outlive it. Reads `scene` only within the methods.
  EndoscopeServer(dds::Participant& participant, const DvrkScene& scene, const Options& options);
  ~EndoscopeServer();
  EndoscopeServer(const EndoscopeServer&) = delete;
  EndoscopeServer& operator=(const EndoscopeServer&) = delete;

  /// Lock-step: takes the next picture with this timestamp.
  void Look(const dds::Stamp& stamp);
  /// Real time: passes the scene on if a picture of it is needed.
  /// @throws the thread's exception; std::runtime_error if drawing fails.
  void Offer(const std::function<dds::Stamp()>& clock);
  /// Restarts the count of pictures. In real time, this takes effect with the next passed scene.
  void Reset() noexcept { restart_ = true; }
  /// While true, no pictures are published.
  void SetSilent(bool silent) noexcept { silent_ = silent; }

  /// Adds noise of one grey level, different in every picture.
  void SetNoisy(bool noisy) noexcept { noisy_ = noisy; }
  /// Delays pictures by a second but gives them current timestamps.
  void SetLate(bool late) noexcept { late_ = late; }

  [[nodiscard]] std::uint64_t published() const noexcept { return published_; }

 private:
  // Owner of the passed scene. kWanted: the caller's thread. kFilled: the camera's thread.
  enum class Hand { kIdle, kWanted, kFilled, kStopped };

  void Run();
  void Take(const LineTrackingPlant& plant, const dds::Stamp& stamp, bool restart, bool frozen);
  void Spoil();
  [[nodiscard]] bool Watched() const noexcept;

  Options options_;
  const DvrkScene* scene_;
  dds::Publisher<dds::Image> raw_;
  dds::Publisher<dds::CompressedImage> compressed_;
  dds::Publisher<dds::CameraInfo> info_;
  recording::JpegEncoder encoder_;
  dds::Image image_;
  dds::CompressedImage jpeg_;
  dds::CameraInfo camera_info_;
  std::uint64_t number_ = 0;
  bool restart_ = false;
  std::atomic<bool> silent_ = false;
  std::atomic<bool> noisy_ = false;
  std::atomic<bool> late_ = false;
  std::uint32_t noise_ = 1;
  std::deque<std::vector<std::uint8_t>> delayed_;  // pictures, oldest first
  std::atomic<std::uint64_t> published_ = 0;

  // Used in real time. `hand_` names the owner of the following members.
  std::atomic<Hand> hand_ = Hand::kIdle;
  std::unique_ptr<LineTrackingPlant> copy_;
  dds::Stamp copy_stamp_;
  bool copy_restart_ = false;
  bool copy_frozen_ = false;
  std::exception_ptr failure_;
  std::atomic<bool> failed_ = false;
  std::atomic<bool> ready_ = false;  // true once the thread has its copy, or has failed
  std::thread thread_;
};

}  // namespace dfr::sim::internal
