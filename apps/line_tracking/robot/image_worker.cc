#include "robot/image_worker.h"

#include <chrono>
#include <cmath>

#include "dfr/runtime/periodic_timer.h"

namespace dfr::apps::line_tracking {
namespace {

using hardware::FrameStatus;
using runtime::HoldReason;

HoldReason ToHoldReason(FrameStatus status) noexcept {
  switch (status) {
    case FrameStatus::kOk:
      return HoldReason::kNone;
    case FrameStatus::kNever:
    case FrameStatus::kSilent:
    case FrameStatus::kEnded:
    case FrameStatus::kTruncated:
    case FrameStatus::kFailed:
      return HoldReason::kImageSilent;
    case FrameStatus::kOld:
      return HoldReason::kImageOld;
    case FrameStatus::kAhead:
    case FrameStatus::kInvalidStamp:
      return HoldReason::kClock;
    case FrameStatus::kWrongSize:
    case FrameStatus::kWrongEncoding:
    case FrameStatus::kDark:
    case FrameStatus::kFrozen:
      return HoldReason::kImageInvalid;
  }
  return HoldReason::kImageInvalid;
}

std::unique_ptr<hardware::Endoscope> Open(dds::Participant& images, const RobotConfig& config,
                                          const vision::CameraModel& camera) {
  hardware::EndoscopeOptions options;
  options.width = camera.width;
  options.height = camera.height;
  options.max_age_s = config.image_max_age_s;
  options.max_repeats = 2;
  if (config.lock_step) {
    // Stamps are in the simulator's time, which is unrelated to this machine's.
    options.max_age_s = 1e5;  // s
    options.max_ahead_s = 1e5;
  }
  return hardware::IsImageTopic(config.camera) ? hardware::OpenTopic(images, config.camera, options)
                                               : hardware::OpenVideo(config.camera, options);
}

}  // namespace

ImageWorker::ImageWorker(dds::Participant& images, const RobotConfig& config,
                         const hardware::PsmDriver& driver, const line_task::LineTask& task,
                         LockStep* lock_step, recording::Recorder* recorder)
    : driver_(&driver),
      task_(&task),
      lock_step_(lock_step),
      answer_ns_(std::llround(1e9 * config.simulator_answer_s)),
      recorder_(recorder),
      endoscope_(Open(images, config, task.calibration().camera)),
      vision_(task.calibration().camera, task.vision()),
      thread_([this] { Run(); }) {}

ImageWorker::~ImageWorker() {
  stop_ = true;
  thread_.join();
}

robot::ThreadHealth ImageWorker::Report() noexcept {
  static_cast<void>(healths_.Take(health_));
  // In lock-step pictures arrive on request.
  if (lock_step_ != nullptr) return {{}, runtime::SteadyNow()};
  return {{ToHoldReason(health_.status), hardware::Name(health_.status)}, health_.checked_ns};
}

robot::Finding ImageWorker::Ask(std::int64_t after_ns) noexcept {
  questions_.Put(
      {++question_, after_ns, task_->TipPlane(driver_->client().measured_js().position), false});
  if (lock_step_ == nullptr) return {};
  if (const robot::Finding lost = lock_step_->Look(); !lost.ok()) return lost;
  const std::int64_t end_ns = runtime::SteadyNow() + answer_ns_;
  while (!answers_.Take(answer_) || answer_.question != question_) {
    if (runtime::SteadyNow() > end_ns) {
      return {HoldReason::kImageSilent, "no picture arrived in which to find the line"};
    }
    std::this_thread::sleep_for(std::chrono::microseconds(100));
  }
  return {};
}

void ImageWorker::AskForMarks(std::int64_t after_ns) noexcept {
  questions_.Put(
      {++question_, after_ns, task_->TipPlane(driver_->client().measured_js().position), true});
}

robot::Camera::Answer ImageWorker::Take(std::span<double> state) noexcept {
  static_cast<void>(answers_.Take(answer_));
  if (answer_.question != question_) return Answer::kPending;
  last_ = answer_;
  task_->State(last_.seen, state);
  return last_.seen.seen() ? Answer::kSeen : Answer::kNotSeen;
}

ImageAnswer ImageWorker::Answer(const Question& question, const hardware::Frame& frame) {
  ImageAnswer answer;
  answer.question = question.number;
  answer.sequence = frame.sequence;
  answer.stamp_ns = frame.stamp_ns;
  if (!question.marks) {
    answer.seen = vision_.Observe(frame.image, question.tip_plane);
    return answer;
  }
  answer.marks_px.resize(task_->vision().target.marks_m.size());
  answer.tip_px = vision_.FindTip(frame.image);
  if (!vision_.FindMarks(frame.image, answer.marks_px)) answer.marks_px.clear();
  return answer;
}

void ImageWorker::Run() {
  runtime::GiveUpRealTime();
  constexpr std::chrono::milliseconds kPoll(2);
  Question question;
  std::uint64_t answered = 0;
  std::uint64_t last = 0;
  hardware::Frame frame;
  for (; !stop_; std::this_thread::sleep_for(kPoll)) {
    const hardware::FrameStatus status = endoscope_->Grab(frame);
    healths_.Put({runtime::SteadyNow(), status});
    questions_.Take(question);
    if (frame.image.data == nullptr || frame.sequence == last) continue;
    last = frame.sequence;
    if (forget_.exchange(false)) vision_.ForgetLastImage();
    // Without lock-step a picture with a fault is not used, even if the loop misses its status.
    const bool usable = lock_step_ != nullptr || status == FrameStatus::kOk;
    if (usable && question.number != answered && frame.stamp_ns >= question.after_ns) {
      answered = question.number;
      answers_.Put(Answer(question, frame));
    }
    if (recorder_ != nullptr) Record(frame);
  }
}

void ImageWorker::Record(const hardware::Frame& frame) noexcept {
  recording::PictureView view;
  view.time_ns = frame.stamp_ns;
  view.sequence = static_cast<std::uint32_t>(frame.sequence);
  view.width = frame.image.width;
  view.height = frame.image.height;
  view.step = static_cast<int>(frame.image.stride);
  view.data = {frame.image.data, frame.image.stride * static_cast<std::size_t>(frame.image.height)};
  static_cast<void>(recorder_->Picture(view));
}

}  // namespace dfr::apps::line_tracking
