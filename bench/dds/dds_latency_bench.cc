// Round-trip time of a pose to another process or thread, and one-way time of a 640 x 480 picture,
// through dfr's publishers and subscribers over each transport, compared with CycloneDDS over UDP
// on the same loopback, and with security. Times are medians and 99th percentiles, in microseconds;
// `of_cyclone` is the median relative to CycloneDDS's. One message is in transit at a time. The
// other process also runs this program. usage: dds_latency_bench [Google Benchmark's options]
#include <benchmark/benchmark.h>
#include <dds/dds.h>
#include <signal.h>
#include <spawn.h>
#include <stdlib.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>
#include <thread>
#include <type_traits>
#include <utility>
#include <vector>

#include "dfr/core/numerics/quantile.h"
#include "dfr/dds/certificates.h"
#include "dfr/dds/channel.h"
#include "ros2_types.h"

namespace dfr::dds {
namespace {

constexpr std::uint32_t kWidth = 640;
constexpr std::uint32_t kHeight = 480;
constexpr double kPatience_s = 20.0;
// Topics that the certificates of a controller and a console permit.
constexpr const char* kAsk = "/PSM1/servo_cp";
constexpr const char* kAnswer = "/PSM1/setpoint_cp";

// Certificates in a folder named after the asking process, which starts the answering process. The
// destructor removes them.
class Keystore {
 public:
  Keystore() {
    MakeAuthority(Folder(::getpid()));
    AddParticipant(Folder(::getpid()), "ask", Permission::kController);
    AddParticipant(Folder(::getpid()), "answer", Permission::kConsole);
  }
  ~Keystore() {
    std::error_code ignored;
    std::filesystem::remove_all(Folder(::getpid()), ignored);
  }
  Keystore(const Keystore&) = delete;
  Keystore& operator=(const Keystore&) = delete;
  static std::string Enclave(bool asks) {
    return Folder(asks ? ::getpid() : ::getppid()) / "enclaves" / (asks ? "ask" : "answer");
  }

 private:
  static std::filesystem::path Folder(pid_t process) {
    return std::filesystem::temp_directory_path() / ("dfr-latency-" + std::to_string(process));
  }
};

// A clock shared by all processes of this machine.
std::int64_t Now() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

// Time at which a question was sent, and its travel time.
struct Answer {
  std::int64_t asked_ns = 0;
  double one_way_s = 0.0;
};

// One end of a pair of topics: stamped questions in one direction and answers in the other.
class End {
 public:
  End() = default;
  virtual ~End() = default;
  End(const End&) = delete;
  End& operator=(const End&) = delete;
  virtual void Ask(std::int64_t now_ns) = 0;
  virtual bool TakeAnswer(double timeout_s, Answer& answer) = 0;
  /// Waits for a question and answers it.
  virtual void Serve(double timeout_s) = 0;
};

PoseStamped Question(const PoseStamped* /*type*/) {
  PoseStamped pose;
  pose.frame_id = "PSM1_base";
  return pose;
}

Image Question(const Image* /*type*/) {
  Image image;
  image.frame_id = "ECM";
  image.encoding = "bgr8";
  image.width = kWidth;
  image.height = kHeight;
  image.step = 3 * kWidth;
  image.data.assign(std::size_t{kHeight} * image.step, 7);
  return image;
}

// An end that uses dfr's publishers and subscribers.
template <typename T>
class OurEnd final : public End {
 public:
  OurEnd(int domain, bool asks, bool shared_memory, const std::string& security)
      : participant_({.domain = domain,
                      .name = "dds_latency_bench",
                      .shared_memory = shared_memory,
                      .security = security}) {
    // Roles without a lifespan, because samples must not expire.
    const Role role = std::is_same_v<T, Image> ? Role::kImage : Role::kState;
    if (asks) {
      ask_ = std::make_unique<Publisher<T>>(participant_, kAsk, role);
      answers_ = std::make_unique<Subscriber<PoseStamped>>(participant_, kAnswer, Role::kState);
    } else {
      asked_ = std::make_unique<Subscriber<T>>(participant_, kAsk, role);
      answer_ = std::make_unique<Publisher<PoseStamped>>(participant_, kAnswer, Role::kState);
    }
  }

  void Ask(std::int64_t now_ns) override {
    message_.stamp = Stamp::FromNanoseconds(now_ns);
    ask_->Write(message_);
  }
  bool TakeAnswer(double timeout_s, Answer& answer) override {
    PoseStamped pose;
    if (!answers_->Wait(timeout_s) || !answers_->Take(pose)) return false;
    answer = {pose.stamp.nanoseconds(), pose.position_m.x()};
    return true;
  }
  void Serve(double timeout_s) override {
    if (!asked_->Wait(timeout_s) || !asked_->Take(message_)) return;
    PoseStamped pose;
    pose.stamp = message_.stamp;
    pose.position_m.x() = 1e-9 * static_cast<double>(Now() - message_.stamp.nanoseconds());
    answer_->Write(pose);
  }

 private:
  Participant participant_;
  T message_ = Question(static_cast<const T*>(nullptr));
  std::unique_ptr<Publisher<T>> ask_;
  std::unique_ptr<Subscriber<PoseStamped>> answers_;
  std::unique_ptr<Subscriber<T>> asked_;
  std::unique_ptr<Publisher<PoseStamped>> answer_;
};

// An end that uses CycloneDDS, with the same types and queue depth.
class CycloneEnd final : public End {
 public:
  CycloneEnd(int domain, bool asks, bool image) : image_(image) {
    participant_ =
        Checked(dds_create_participant(static_cast<dds_domainid_t>(domain), nullptr, nullptr));
    const dds_topic_descriptor_t& type =
        image ? sensor_msgs_msg_dds__Image__desc : geometry_msgs_msg_dds__PoseStamped__desc;
    const dds_entity_t ask =
        Checked(dds_create_topic(participant_, &type, "rt/ask", nullptr, nullptr));
    const dds_entity_t answer = Checked(dds_create_topic(
        participant_, &geometry_msgs_msg_dds__PoseStamped__desc, "rt/answer", nullptr, nullptr));
    dds_qos_t* qos = dds_create_qos();
    dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 1);
    writer_ = Checked(dds_create_writer(participant_, asks ? ask : answer, qos, nullptr));
    reader_ = Checked(dds_create_reader(participant_, asks ? answer : ask, qos, nullptr));
    dds_delete_qos(qos);
    waitset_ = Checked(dds_create_waitset(participant_));
    const dds_entity_t condition = Checked(dds_create_readcondition(reader_, DDS_ANY_STATE));
    Checked(dds_waitset_attach(waitset_, condition, 0));
    pixels_.assign(std::size_t{kHeight} * 3 * kWidth, 7);
  }
  ~CycloneEnd() override { dds_delete(participant_); }

  void Ask(std::int64_t now_ns) override {
    if (image_) {
      sensor_msgs_msg_dds__Image_ image{};
      Stamp(now_ns, image.header_);
      image.encoding_ = encoding_.data();
      image.width_ = kWidth;
      image.height_ = kHeight;
      image.step_ = 3 * kWidth;
      image.data_._buffer = pixels_.data();
      image.data_._length = image.data_._maximum = static_cast<std::uint32_t>(pixels_.size());
      Checked(dds_write(writer_, &image));
    } else {
      Write(now_ns, 0.0);
    }
  }
  bool TakeAnswer(double timeout_s, Answer& answer) override {
    return Take<geometry_msgs_msg_dds__PoseStamped_>(timeout_s, [&](const auto& pose) {
      answer = {Nanoseconds(pose.header_), pose.pose_.position_.x_};
    });
  }
  void Serve(double timeout_s) override {
    // Copies the message, as dfr does.
    const auto reply = [this](const auto& message) {
      const std::int64_t asked_ns = Nanoseconds(message.header_);
      Write(asked_ns, 1e-9 * static_cast<double>(Now() - asked_ns));
    };
    if (image_) {
      Take<sensor_msgs_msg_dds__Image_>(timeout_s, [&](const auto& image) {
        pixels_.assign(image.data_._buffer, image.data_._buffer + image.data_._length);
        reply(image);
      });
    } else {
      Take<geometry_msgs_msg_dds__PoseStamped_>(timeout_s, reply);
    }
  }

 private:
  static dds_entity_t Checked(dds_return_t code) {
    if (code < 0) throw std::runtime_error(std::string("CycloneDDS: ") + dds_strretcode(code));
    return code;
  }
  static std::int64_t Nanoseconds(const std_msgs_msg_dds__Header_& header) {
    return std::int64_t{1'000'000'000} * header.stamp_.sec_ + header.stamp_.nanosec_;
  }
  void Stamp(std::int64_t ns, std_msgs_msg_dds__Header_& header) {
    header.stamp_.sec_ = static_cast<std::int32_t>(ns / 1'000'000'000);
    header.stamp_.nanosec_ = static_cast<std::uint32_t>(ns % 1'000'000'000);
    header.frame_id_ = frame_.data();
  }
  void Write(std::int64_t asked_ns, double one_way_s) {
    geometry_msgs_msg_dds__PoseStamped_ pose{};
    Stamp(asked_ns, pose.header_);
    pose.pose_.position_.x_ = one_way_s;
    Checked(dds_write(writer_, &pose));
  }
  template <typename T, typename Use>
  bool Take(double timeout_s, Use use) {
    if (dds_waitset_wait(waitset_, nullptr, 0, static_cast<dds_duration_t>(1e9 * timeout_s)) <= 0) {
      return false;
    }
    void* sample = nullptr;  // allocated by dds_take()
    dds_sample_info_t info;
    const dds_return_t count = dds_take(reader_, &sample, &info, 1, 1);
    Checked(count);
    const bool any = count > 0 && info.valid_data;
    if (any) use(*static_cast<const T*>(sample));
    if (count > 0) dds_return_loan(reader_, &sample, count);
    return any;
  }

  bool image_;
  dds_entity_t participant_ = 0;
  dds_entity_t writer_ = 0;
  dds_entity_t reader_ = 0;
  dds_entity_t waitset_ = 0;
  std::string frame_ = "PSM1_base";
  std::string encoding_ = "bgr8";
  std::vector<std::uint8_t> pixels_;
};

enum class Way { kCyclone, kUdp, kSharedMemory, kSameProcess, kSecured };

std::unique_ptr<End> MakeEnd(Way way, bool image, bool asks) {
  // Each case has a separate domain, above the domains of the tests.
  const int domain = 103 + 2 * static_cast<int>(way) + (image ? 1 : 0);
  if (way == Way::kCyclone) return std::make_unique<CycloneEnd>(domain, asks, image);
  const bool shared_memory = way == Way::kSharedMemory;
  const std::string security = way == Way::kSecured ? Keystore::Enclave(asks) : "";
  if (image) return std::make_unique<OurEnd<Image>>(domain, asks, shared_memory, security);
  return std::make_unique<OurEnd<PoseStamped>>(domain, asks, shared_memory, security);
}

int ServeForEver(Way way, bool image) {
  const std::unique_ptr<End> end = MakeEnd(way, image, false);
  while (::getppid() != 1) end->Serve(1.0);
  return EXIT_SUCCESS;
}

// Both ends: one in this thread, and one in another process or thread that the object runs.
class Link {
 public:
  Link(Way way, bool image) {
    if (way == Way::kSameProcess) {
      thread_ = std::thread([this, image] {
        const std::unique_ptr<End> end = MakeEnd(Way::kSameProcess, image, false);
        while (!stopped_) end->Serve(0.1);
      });
    } else {
      std::string self = std::filesystem::read_symlink("/proc/self/exe");
      std::string mode = "--serve";
      std::string which = std::to_string(static_cast<int>(way));
      std::string what = image ? "1" : "0";
      char* argv[] = {self.data(), mode.data(), which.data(), what.data(), nullptr};
      if (::posix_spawn(&pid_, self.c_str(), nullptr, nullptr, argv, environ) != 0) {
        throw std::runtime_error("cannot start " + self);
      }
    }
    end_ = MakeEnd(way, image, true);
  }
  ~Link() {
    stopped_ = true;
    if (thread_.joinable()) thread_.join();
    if (pid_ < 0) return;
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
  }
  Link(const Link&) = delete;
  Link& operator=(const Link&) = delete;

  /// Sends a question and waits for the answer. Returns false if no answer arrives.
  bool Exchange(double timeout_s, double& round_trip_s, double& one_way_s) {
    const std::int64_t start = Now();
    end_->Ask(start);
    Answer answer;
    while (answer.asked_ns != start) {
      const double left_s = timeout_s - 1e-9 * static_cast<double>(Now() - start);
      if (left_s <= 0.0 || !end_->TakeAnswer(left_s, answer)) return false;
    }
    round_trip_s = 1e-9 * static_cast<double>(Now() - start);
    one_way_s = answer.one_way_s;
    return true;
  }

 private:
  std::unique_ptr<End> end_;
  std::thread thread_;
  std::atomic<bool> stopped_ = false;
  pid_t pid_ = -1;
};

using Case = std::pair<Way, bool>;

// Links are created once, because discovery takes longer than a measurement.
std::map<Case, std::unique_ptr<Link>>& Links() {
  static std::map<Case, std::unique_ptr<Link>> links;
  return links;
}

void Measure(benchmark::State& state, Way way, bool image) {
  static std::map<bool, double> cyclone_s;
  std::unique_ptr<Link>& link = Links()[{way, image}];
  double round_trip_s = 0.0;
  double one_way_s = 0.0;
  if (!link) {
    link = std::make_unique<Link>(way, image);
    const std::int64_t end = Now() + static_cast<std::int64_t>(1e9 * kPatience_s);
    while (!link->Exchange(0.2, round_trip_s, one_way_s)) {
      if (Now() > end) return state.SkipWithError("the other end does not answer");
    }
    for (int i = 0; i < 20; ++i) link->Exchange(1.0, round_trip_s, one_way_s);
  }
  std::vector<double> times_s;
  for (auto _ : state) {
    if (!link->Exchange(5.0, round_trip_s, one_way_s)) {
      return state.SkipWithError("a message was lost");
    }
    times_s.push_back(image ? one_way_s : round_trip_s);
    state.SetIterationTime(times_s.back());
  }
  const double median_s = core::Quantile(times_s, 0.5);
  if (way == Way::kCyclone) cyclone_s[image] = median_s;
  state.counters["p50_us"] = 1e6 * median_s;
  state.counters["p99_us"] = 1e6 * core::Quantile(times_s, 0.99);
  if (cyclone_s.contains(image)) state.counters["of_cyclone"] = median_s / cyclone_s[image];
}

void BM_PoseRoundTrip(benchmark::State& state, Way way) { Measure(state, way, false); }
void BM_SecuredPoseRoundTrip(benchmark::State& state) {
  static const Keystore kKeystore;
  Measure(state, Way::kSecured, false);
}
void BM_ImageOneWay(benchmark::State& state, Way way) { Measure(state, way, true); }

#define DFR_CASE(Benchmark, name, way) \
  BENCHMARK_CAPTURE(Benchmark, name, way)->UseManualTime()->Unit(benchmark::kMicrosecond)
DFR_CASE(BM_PoseRoundTrip, cyclone_udp, Way::kCyclone);
DFR_CASE(BM_PoseRoundTrip, udp, Way::kUdp);
DFR_CASE(BM_PoseRoundTrip, shared_memory, Way::kSharedMemory);
DFR_CASE(BM_PoseRoundTrip, same_process, Way::kSameProcess);
DFR_CASE(BM_ImageOneWay, cyclone_udp, Way::kCyclone);
DFR_CASE(BM_ImageOneWay, udp, Way::kUdp);
DFR_CASE(BM_ImageOneWay, shared_memory, Way::kSharedMemory);
DFR_CASE(BM_ImageOneWay, same_process, Way::kSameProcess);
#undef DFR_CASE
BENCHMARK(BM_SecuredPoseRoundTrip)->UseManualTime()->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace dfr::dds

int main(int argc, char** argv) {
  // CycloneDDS uses only the loopback, as dfr does, and no multicast, which a loopback may lack.
  ::setenv("CYCLONEDDS_URI",
           "<CycloneDDS><Domain><General><Interfaces><NetworkInterface address=\"127.0.0.1\"/>"
           "</Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery>"
           "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>24"
           "</MaxAutoParticipantIndex><Peers><Peer address=\"127.0.0.1\"/></Peers></Discovery>"
           "</Domain></CycloneDDS>",
           1);
  if (argc == 4 && std::string_view(argv[1]) == "--serve") {
    return dfr::dds::ServeForEver(static_cast<dfr::dds::Way>(std::atoi(argv[2])),
                                  std::string_view(argv[3]) == "1");
  }
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return EXIT_FAILURE;
  benchmark::RunSpecifiedBenchmarks();
  dfr::dds::Links().clear();
  return EXIT_SUCCESS;
}
