#pragma once

#include <Eigen/Geometry>
#include <atomic>
#include <cstdint>
#include <memory>
#include <thread>
#include <vector>

#include "dfr/hardware/endoscope.h"
#include "dfr/hardware/psm_driver.h"
#include "dfr/line_task/line_task.h"
#include "dfr/recording/recorder.h"
#include "dfr/robot/devices.h"
#include "dfr/runtime/latest.h"
#include "dfr/vision/line_vision.h"
#include "robot/robot_config.h"
#include "simulator/lock_step.h"

namespace dfr::apps::line_tracking {

/// Results of a requested picture.
struct ImageAnswer {
  std::uint64_t question = 0;  ///< Number of the request, counted from 1.
  std::uint64_t sequence = 0;
  std::int64_t stamp_ns = 0;
  vision::LineObservation seen;
  /// Answer to AskForMarks(): marks (empty if not found) and tip as in a vision::CalibrationFrame.
  /// `seen` is then empty.
  std::vector<Eigen::Vector2d> marks_px;
  Eigen::Vector2d tip_px = Eigen::Vector2d::Zero();
};

/// The endoscope of line tracking as the camera of a robot::ControlLoop. A separate thread
/// processes the pictures: the loop never waits for OpenCV.
class ImageWorker final : public robot::Camera {
 public:
  /// Opens config.camera. Borrows all arguments.
  /// @param lock_step  nullptr in real time; otherwise Ask() waits for the answer.
  /// @param recorder  receives every picture; may be nullptr.
  /// @throws std::runtime_error as hardware::OpenVideo() and hardware::OpenTopic().
  ImageWorker(dds::Participant& images, const RobotConfig& config,
              const hardware::PsmDriver& driver, const line_task::LineTask& task,
              LockStep* lock_step, recording::Recorder* recorder);
  ~ImageWorker() override;
  ImageWorker(const ImageWorker&) = delete;
  ImageWorker& operator=(const ImageWorker&) = delete;

  [[nodiscard]] robot::ThreadHealth Report() noexcept override;
  [[nodiscard]] robot::Finding Ask(std::int64_t after_ns) noexcept override;
  [[nodiscard]] Answer Take(std::span<double> state) noexcept override;
  /// Replaces Ask() for a calibration, in real time: finds only marks and tip, without the
  /// calibration of camera and arm. Allocates memory for the marks.
  void AskForMarks(std::int64_t after_ns) noexcept;
  /// Begins a new episode: the next picture is not compared with the previous one.
  void Forget() noexcept { forget_ = true; }

  /// Picture of the last state, and the features in it.
  [[nodiscard]] const ImageAnswer& last() const noexcept { return last_; }

 private:
  struct Question {
    std::uint64_t number = 0;
    std::int64_t after_ns = 0;
    Eigen::Hyperplane<double, 3> tip_plane;
    bool marks = false;
  };
  struct Health {
    std::int64_t checked_ns = 0;
    hardware::FrameStatus status = hardware::FrameStatus::kNever;
  };
  void Run();
  [[nodiscard]] ImageAnswer Answer(const Question& question, const hardware::Frame& frame);
  void Record(const hardware::Frame& frame) noexcept;

  const hardware::PsmDriver* driver_;
  const line_task::LineTask* task_;
  LockStep* lock_step_;
  std::int64_t answer_ns_;  // timeout of a request in lock-step
  recording::Recorder* recorder_;
  runtime::Latest<Question> questions_;
  runtime::Latest<ImageAnswer> answers_;
  runtime::Latest<Health> healths_;
  std::atomic<bool> forget_ = false;
  std::atomic<bool> stop_ = false;
  // Used by the loop's thread.
  std::uint64_t question_ = 0;
  Health health_;
  ImageAnswer answer_;
  ImageAnswer last_;
  // Used by the worker's thread.
  std::unique_ptr<hardware::Endoscope> endoscope_;
  vision::LineVision vision_;
  std::thread thread_;
};

}  // namespace dfr::apps::line_tracking
