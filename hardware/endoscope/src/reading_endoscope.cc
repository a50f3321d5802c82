#include "reading_endoscope.h"

#include <chrono>
#include <exception>
#include <thread>

namespace dfr::hardware::internal {
namespace {

class ReadingEndoscope final : public Endoscope {
 public:
  ReadingEndoscope(const std::string& source, const EndoscopeOptions& options, const Read& read)
      : source_(source), feed_(options) {
    thread_ = std::thread([this, read] {
      try {
        read(feed_, stop_);
      } catch (const std::exception&) {
        feed_.End(FrameStatus::kFailed);
      }
    });
  }
  ~ReadingEndoscope() override {
    stop_.store(true, std::memory_order_relaxed);
    thread_.join();
  }
  ReadingEndoscope(const ReadingEndoscope&) = delete;
  ReadingEndoscope& operator=(const ReadingEndoscope&) = delete;

  FrameStatus Grab(std::int64_t steady_ns, std::int64_t wall_ns, Frame& frame) noexcept override {
    return feed_.Grab(steady_ns, wall_ns, frame);
  }
  [[nodiscard]] EndoscopeCounts counts() const noexcept override { return feed_.counts(); }
  [[nodiscard]] const std::string& source() const noexcept override { return source_; }

 private:
  std::string source_;
  Feed feed_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace

std::unique_ptr<Endoscope> MakeEndoscope(const std::string& source, const EndoscopeOptions& options,
                                         const Read& read) {
  return std::make_unique<ReadingEndoscope>(source, options, read);
}

std::int64_t SteadyNs() noexcept {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

}  // namespace dfr::hardware::internal
