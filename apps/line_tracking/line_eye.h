#pragma once

#include <Eigen/Geometry>
#include <atomic>
#include <cstdint>
#include <memory>
#include <thread>

#include "dfr/hardware/endoscope.h"
#include "dfr/line_task/line_task.h"
#include "dfr/recording/recorder.h"
#include "dfr/runtime/latest.h"
#include "dfr/vision/line_vision.h"

namespace dfr::apps::line_tracking {

/// How the endoscope stands.
struct EyeNews {
  std::int64_t steady_ns = 0;  ///< When that was.
  hardware::FrameStatus status = hardware::FrameStatus::kNever;
};

/// What a picture that was asked for shows.
struct EyeSight {
  std::uint64_t question = 0;
  std::uint64_t sequence = 0;
  std::int64_t stamp_ns = 0;
  vision::LineObservation seen;
};

/// Looks at an endoscope's pictures in a thread of its own, so that the control loop never waits
/// for OpenCV. Ask() and both Take() belong to one thread, and neither allocate, lock nor wait.
class LineEye {
 public:
  /// @param recorder  gets every picture; may be nullptr, else outlives this.
  LineEye(std::unique_ptr<hardware::Endoscope> endoscope, const line_task::LineTask& task,
          recording::Recorder* recorder);
  ~LineEye();
  LineEye(const LineEye&) = delete;
  LineEye& operator=(const LineEye&) = delete;

  /// Asks what the first picture shows that is stamped at `after_ns` or later. Replaces a question
  /// that was not answered. Questions are numbered from 1.
  void Ask(std::uint64_t question, std::int64_t after_ns,
           const Eigen::Hyperplane<double, 3>& tip_plane) noexcept;
  /// A new episode: the next picture is not compared with the one before.
  void Forget() noexcept { forget_ = true; }

  /// The newest that was not taken. False if there is none.
  [[nodiscard]] bool Take(EyeSight& sight) noexcept { return sights_.Take(sight); }
  [[nodiscard]] bool Take(EyeNews& news) noexcept { return news_.Take(news); }

 private:
  struct Question {
    std::uint64_t number = 0;
    std::int64_t after_ns = 0;
    Eigen::Hyperplane<double, 3> tip_plane;
  };
  void Run();
  void Record(const hardware::Frame& frame) noexcept;

  std::unique_ptr<hardware::Endoscope> endoscope_;
  vision::LineVision vision_;
  recording::Recorder* recorder_;
  runtime::Latest<Question> questions_;
  runtime::Latest<EyeSight> sights_;
  runtime::Latest<EyeNews> news_;
  std::atomic<bool> forget_ = false;
  std::atomic<bool> stop_ = false;
  std::thread thread_;
};

}  // namespace dfr::apps::line_tracking
