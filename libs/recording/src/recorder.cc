#include "dfr/recording/recorder.h"

#include <pthread.h>
#include <sched.h>
#include <signal.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <exception>
#include <map>
#include <stdexcept>
#include <thread>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/recording/jpeg_encoder.h"
#include "mcap_writer.h"
#include "spsc_ring.h"

namespace dfr::recording {
namespace {

constexpr std::int64_t kPeriodNs = 25'000'000;
constexpr std::int64_t kFlushNs = 200'000'000;
constexpr std::size_t kChunkBytes = std::size_t{1} << 20;

// A pending record. Only the member of the record's kind is valid.
struct WaitingRecord {
  StepRecord step;
  TransitionRecord transition;
  ArmRecord arm;
  std::uint32_t sequence = 0;
  internal::Channel channel = internal::Channel::kStep;
};

struct WaitingPicture {
  PictureView view;  // refers to `bytes`
  std::vector<std::uint8_t> bytes;
};

class MachineClock final : public RecorderClock {
 public:
  [[nodiscard]] std::int64_t SteadyNs() override {
    return std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count();
  }
  void Wait(std::int64_t ns, const std::atomic<bool>& /*stopping*/) override {
    std::this_thread::sleep_for(std::chrono::nanoseconds(ns));
  }
};

std::int64_t Now() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

std::map<std::string, std::string> Entries(const RecordingMetadata& metadata) {
  std::map<std::string, std::string> entries = metadata.more;
  entries["program"] = metadata.program;
  entries["commit"] = metadata.commit;
  entries["model"] = metadata.model;
  entries["model_checksum"] = metadata.model_checksum;
  entries["method"] = metadata.method;
  entries["seed"] = std::to_string(metadata.seed);
  return entries;
}

RecorderOptions Checked(const RecorderOptions& options) {
  DFR_THROW_UNLESS(options.waiting_records >= 1,
                   "waiting_records must be positive, not " << options.waiting_records);
  DFR_THROW_UNLESS(options.waiting_pictures >= 1,
                   "waiting_pictures must be positive, not " << options.waiting_pictures);
  DFR_THROW_UNLESS(options.jpeg_quality >= 1 && options.jpeg_quality <= 100,
                   "jpeg_quality must lie in [1, 100], not " << options.jpeg_quality);
  return options;
}

std::string Lost(std::uint64_t records, std::uint64_t pictures) {
  return std::to_string(records) + " steps, transitions or states of the arm and " +
         std::to_string(pictures) +
         " pictures were lost: the disk or the processor is too slow, or a picture was too large "
         "or invalid";
}

// Blocks signals for threads started during its lifetime: signals belong to the program's threads.
class BlockedSignals {
 public:
  BlockedSignals() {
    sigset_t all;
    ::sigfillset(&all);
    ::pthread_sigmask(SIG_SETMASK, &all, &before_);
  }
  ~BlockedSignals() { ::pthread_sigmask(SIG_SETMASK, &before_, nullptr); }
  BlockedSignals(const BlockedSignals&) = delete;
  BlockedSignals& operator=(const BlockedSignals&) = delete;

 private:
  sigset_t before_{};
};

}  // namespace

struct Recorder::Impl {
  Impl(const std::filesystem::path& file, const RecordingMetadata& metadata,
       const RecorderOptions& chosen)
      : path(file),
        options(Checked(chosen)),
        records(options.waiting_records, {}),
        pictures(options.waiting_pictures,
                 {.view = {}, .bytes = std::vector<std::uint8_t>(options.picture_bytes)}),
        clock(options.clock != nullptr ? options.clock : &machine),
        jpeg(options.jpeg_quality),
        writer(file, Entries(metadata), metadata.configuration, Now()) {
    const BlockedSignals blocked;
    thread = std::thread([this] { Run(); });
  }
  ~Impl() { Stop(); }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  void Stop() noexcept {
    stopping.store(true, std::memory_order_release);
    if (thread.joinable()) thread.join();
  }

  // Runs the writing thread, without the priority of a control loop.
  void Run() noexcept {
    const sched_param none{};
    ::pthread_setschedparam(::pthread_self(), SCHED_OTHER, &none);
    try {
      std::int64_t flushed_ns = clock->SteadyNs();
      bool last = false;
      while (!last) {
        last = stopping.load(std::memory_order_acquire);
        if (!last) clock->Wait(kPeriodNs, stopping);
        Drain();
        Report();
        if (last || clock->SteadyNs() - flushed_ns >= kFlushNs) {
          Check(writer.Flush());
          flushed_ns = clock->SteadyNs();
        }
      }
      Check(writer.Finish());
    } catch (const std::exception& e) {
      thrown = e.what();
      Check(false);
    }
  }

  // Counts the messages since the last call as written or lost.
  void Check(bool written) {
    (written ? records_written : dropped_records)
        .fetch_add(records_in_chunk, std::memory_order_relaxed);
    (written ? pictures_written : dropped_pictures)
        .fetch_add(pictures_in_chunk, std::memory_order_relaxed);
    records_in_chunk = 0;
    pictures_in_chunk = 0;
    // dropped() includes the lost chunk once failed() is true.
    if (!written) failed.store(true, std::memory_order_release);
  }

  void Drain() {
    while (const WaitingRecord* waiting = records.Front()) {
      const auto write = [&](const auto& record) {
        message.clear();
        internal::Encode(record, message);
        writer.Message(waiting->channel, waiting->sequence, record.time_ns, message);
      };
      if (waiting->channel == internal::Channel::kStep) {
        write(waiting->step);
      } else if (waiting->channel == internal::Channel::kTransition) {
        write(waiting->transition);
      } else {
        write(waiting->arm);
      }
      records.Pop();
      Count(records_in_chunk);
    }
    while (const WaitingPicture* waiting = pictures.Front()) {
      const std::string_view file = jpeg.Encode(waiting->view);
      if (file.empty()) {
        dropped_pictures.fetch_add(1, std::memory_order_relaxed);
      } else {
        message.clear();
        internal::EncodePicture(waiting->view.time_ns, file, message);
        writer.Message(internal::Channel::kPicture, waiting->view.sequence, waiting->view.time_ns,
                       message);
        Count(pictures_in_chunk);
      }
      pictures.Pop();
    }
  }

  void Count(std::uint64_t& in_chunk) {
    ++in_chunk;
    if (writer.chunk_bytes() >= kChunkBytes) Check(writer.Flush());
  }

  // Writes a note of the losses since the last note.
  void Report() {
    const std::uint64_t lost_records = dropped_records.load(std::memory_order_relaxed);
    const std::uint64_t lost_pictures = dropped_pictures.load(std::memory_order_relaxed);
    if (lost_records == reported_records && lost_pictures == reported_pictures) return;
    const std::int64_t now = Now();
    message.clear();
    internal::EncodeNote(
        now, Lost(lost_records - reported_records, lost_pictures - reported_pictures), message);
    writer.Message(internal::Channel::kNote, ++notes, now, message);
    reported_records = lost_records;
    reported_pictures = lost_pictures;
  }

  template <typename T>
  bool Push(internal::Channel channel, T WaitingRecord::*member, const T& record,
            std::uint32_t sequence) noexcept {
    WaitingRecord* waiting = records.Free();
    if (waiting == nullptr) {
      dropped_records.fetch_add(1, std::memory_order_relaxed);
      return false;
    }
    waiting->channel = channel;
    waiting->sequence = sequence;
    waiting->*member = record;
    records.Push();
    return true;
  }

  const std::filesystem::path path;
  const RecorderOptions options;
  internal::SpscRing<WaitingRecord> records;
  internal::SpscRing<WaitingPicture> pictures;
  std::atomic<std::uint64_t> dropped_records{0};
  std::atomic<std::uint64_t> dropped_pictures{0};
  std::atomic<std::uint64_t> records_written{0};
  std::atomic<std::uint64_t> pictures_written{0};
  std::atomic<bool> failed{false};
  std::atomic<bool> stopping{false};
  // Used only by the thread that calls Record(), Transition() and Arm().
  std::uint32_t steps = 0;
  std::uint32_t transitions = 0;
  std::uint32_t arms = 0;
  // Used only by the writing thread, while it runs.
  MachineClock machine;
  RecorderClock* const clock;
  JpegEncoder jpeg;
  internal::McapWriter writer;
  std::string message;
  std::string thrown;
  std::uint64_t records_in_chunk = 0;
  std::uint64_t pictures_in_chunk = 0;
  std::uint64_t reported_records = 0;
  std::uint64_t reported_pictures = 0;
  std::uint32_t notes = 0;
  std::thread thread;
};

Recorder::Recorder(const std::filesystem::path& path, const RecordingMetadata& metadata,
                   const RecorderOptions& options)
    : impl_(std::make_unique<Impl>(path, metadata, options)) {}

Recorder::~Recorder() = default;

// Numbers each record, even a dropped one: a gap in the file then shows the number of lost records.
bool Recorder::Record(const StepRecord& step) noexcept {
  return impl_->Push(internal::Channel::kStep, &WaitingRecord::step, step, ++impl_->steps);
}

bool Recorder::Transition(const TransitionRecord& transition) noexcept {
  return impl_->Push(internal::Channel::kTransition, &WaitingRecord::transition, transition,
                     ++impl_->transitions);
}

bool Recorder::Arm(const ArmRecord& arm) noexcept {
  return impl_->Push(internal::Channel::kArm, &WaitingRecord::arm, arm, ++impl_->arms);
}

bool Recorder::Picture(const PictureView& picture) noexcept {
  WaitingPicture* waiting = impl_->pictures.Free();
  const int pixel = picture.format == PictureFormat::kMono8 ? 1 : 3;
  const bool is_picture =
      picture.format == PictureFormat::kJpeg ||
      (picture.width > 0 && picture.height > 0 && picture.step / pixel >= picture.width &&
       static_cast<std::size_t>(picture.step) * static_cast<std::size_t>(picture.height) <=
           picture.data.size());
  if (waiting == nullptr || !is_picture || picture.data.size() > waiting->bytes.size()) {
    impl_->dropped_pictures.fetch_add(1, std::memory_order_relaxed);
    return false;
  }
  std::copy(picture.data.begin(), picture.data.end(), waiting->bytes.begin());
  waiting->view = picture;
  waiting->view.data = std::span(waiting->bytes).first(picture.data.size());
  impl_->pictures.Push();
  return true;
}

bool Recorder::failed() const noexcept { return impl_->failed.load(std::memory_order_acquire); }

std::uint64_t Recorder::dropped() const noexcept {
  return impl_->dropped_records.load(std::memory_order_relaxed) +
         impl_->dropped_pictures.load(std::memory_order_relaxed);
}

RecorderCounts Recorder::counts() const noexcept {
  return {.records = impl_->records_written.load(std::memory_order_relaxed),
          .pictures = impl_->pictures_written.load(std::memory_order_relaxed),
          .dropped_records = impl_->dropped_records.load(std::memory_order_relaxed),
          .dropped_pictures = impl_->dropped_pictures.load(std::memory_order_relaxed)};
}

void Recorder::Finish() {
  impl_->Stop();
  const std::string wrong = impl_->thrown.empty() ? impl_->writer.error() : impl_->thrown;
  if (!wrong.empty()) {
    throw std::runtime_error("the log " + impl_->path.string() + " is incomplete: " + wrong +
                             "; it is readable up to that point");
  }
}

}  // namespace dfr::recording
