#include "line_eye.h"

#include <chrono>
#include <utility>

#include "dfr/runtime/periodic_timer.h"

namespace dfr::apps::line_tracking {

LineEye::LineEye(std::unique_ptr<hardware::Endoscope> endoscope, const line_task::LineTask& task,
                 recording::Recorder* recorder)
    : endoscope_(std::move(endoscope)),
      vision_(task.calibration().camera, task.vision()),
      recorder_(recorder),
      thread_([this] { Run(); }) {}

LineEye::~LineEye() {
  stop_ = true;
  thread_.join();
}

void LineEye::Ask(std::uint64_t question, std::int64_t after_ns,
                  const Eigen::Hyperplane<double, 3>& tip_plane) noexcept {
  questions_.Put({question, after_ns, tip_plane});
}

void LineEye::Run() {
  runtime::GiveUpRealTime();
  constexpr std::chrono::milliseconds kPoll(2);
  Question question;
  std::uint64_t answered = 0;
  std::uint64_t last = 0;
  hardware::Frame frame;
  for (; !stop_; std::this_thread::sleep_for(kPoll)) {
    EyeNews news;
    news.status = endoscope_->Grab(frame);
    news.steady_ns = runtime::SteadyNow();
    news_.Put(news);
    questions_.Take(question);
    if (frame.image.data == nullptr || frame.sequence == last) continue;
    last = frame.sequence;
    if (forget_.exchange(false)) vision_.ForgetLastImage();
    if (question.number != answered && frame.stamp_ns >= question.after_ns) {
      answered = question.number;
      EyeSight sight;
      sight.question = question.number;
      sight.sequence = frame.sequence;
      sight.stamp_ns = frame.stamp_ns;
      sight.seen = vision_.Observe(frame.image, question.tip_plane);
      sights_.Put(sight);
    }
    if (recorder_ != nullptr) Record(frame);
  }
}

void LineEye::Record(const hardware::Frame& frame) noexcept {
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
