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

/// The endoscope's topics: image_raw, image_raw/compressed, camera_info.
///
/// In lock-step Look() takes a picture when it is told to. In real time a thread of its own draws a
/// copy of the scene that the caller's thread hands over in Offer() when one is wanted: neither
/// waits for the other, so that the arm's state is not late because a picture takes long. Pictures
/// are drawn only while there is a subscriber.
class EndoscopeServer {
 public:
  struct Options {
    std::string name;
    double period_s = 0.0;
    int jpeg_quality = 0;
    bool real_time = false;
  };

  /// Borrows both, which must outlive it; `scene` is not looked at but within the methods.
  EndoscopeServer(dds::Participant& participant, const DvrkScene& scene, const Options& options);
  ~EndoscopeServer();
  EndoscopeServer(const EndoscopeServer&) = delete;
  EndoscopeServer& operator=(const EndoscopeServer&) = delete;

  /// Lock-step: the next picture, stamped so.
  void Look(const dds::Stamp& stamp);
  /// Real time: hands the scene over if a picture of it is wanted.
  /// @throws what went wrong in the thread, std::runtime_error if nothing can be drawn.
  void Offer(const std::function<dds::Stamp()>& clock);
  /// Pictures are counted from Reset() on. The count goes to the thread with the next scene.
  void Reset() noexcept { restart_ = true; }
  /// Nothing comes from the camera any more.
  void SetSilent(bool silent) noexcept { silent_ = silent; }

  /// Every picture differs from the one before by noise of one grey level.
  void SetNoisy(bool noisy) noexcept { noisy_ = noisy; }
  /// Pictures are of a second ago, with the stamps of now.
  void SetLate(bool late) noexcept { late_ = late; }

  [[nodiscard]] std::uint64_t published() const noexcept { return published_; }

 private:
  // Who has the scene that is handed over: Wanted, the caller's thread; Filled, the camera's.
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
  std::deque<std::vector<std::uint8_t>> delayed_;  // pictures, the oldest first
  std::atomic<std::uint64_t> published_ = 0;

  // Real time. What follows `hand_` belongs to whom it says.
  std::atomic<Hand> hand_ = Hand::kIdle;
  std::unique_ptr<LineTrackingPlant> copy_;
  dds::Stamp copy_stamp_;
  bool copy_restart_ = false;
  bool copy_frozen_ = false;
  std::exception_ptr failure_;
  std::atomic<bool> failed_ = false;
  std::thread thread_;
};

}  // namespace dfr::sim::internal
