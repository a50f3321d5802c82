#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <csignal>
#include <string>
#include <string_view>
#include <thread>

#include "dfr/dds/emergency_stop.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"

namespace dfr {
namespace {

using dds::EmergencyStop;
using Clock = std::chrono::steady_clock;

// A busy machine gets a minute.
bool Becomes(dds::EmergencyStopReceiver& receiver, EmergencyStop wanted) {
  const auto end = Clock::now() + std::chrono::seconds(60);
  while (Clock::now() < end) {
    if (receiver.Check(Clock::now().time_since_epoch().count()) == wanted) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return false;
}

TEST(StopTest, AnUnattendedStopSaysThatAllIsWellAndItsDeathStops) {
  const int domain = test::OwnDomain();
  dds::Participant robot({.domain = domain});
  dds::EmergencyStopReceiver receiver(robot, 1.0);
  test::PeerProcess stop(
      {DFR_HARDWARE, "stop", "--unattended", "--domain", std::to_string(domain)});
  ASSERT_TRUE(Becomes(receiver, EmergencyStop::kClear));
  stop.Signal(SIGSTOP);
  EXPECT_TRUE(Becomes(receiver, EmergencyStop::kSilent));
  stop.Signal(SIGCONT);
  EXPECT_TRUE(Becomes(receiver, EmergencyStop::kClear));
  stop.Signal(SIGINT);
  EXPECT_EQ(stop.Await(60.0), 0);
  EXPECT_TRUE(Becomes(receiver, EmergencyStop::kSilent));
}

// A stop at a keyboard that this process types at.
class TypedStop {
 public:
  explicit TypedStop(int domain) {
    std::array<int, 2> ends{};
    EXPECT_EQ(::pipe2(ends.data(), O_CLOEXEC), 0);
    pid_ = ::fork();
    if (pid_ == 0) {
      ::prctl(PR_SET_PDEATHSIG, SIGKILL);
      ::dup2(ends[0], STDIN_FILENO);
      ::execl(DFR_HARDWARE, DFR_HARDWARE, "stop", "--domain", std::to_string(domain).c_str(),
              nullptr);
      ::_exit(127);
    }
    ::close(ends[0]);
    input_ = ends[1];
  }
  ~TypedStop() {
    ::close(input_);
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
  }
  TypedStop(const TypedStop&) = delete;
  TypedStop& operator=(const TypedStop&) = delete;

  void Type(std::string_view text) const {
    EXPECT_EQ(::write(input_, text.data(), text.size()), static_cast<ssize_t>(text.size()));
  }

 private:
  pid_t pid_ = -1;
  int input_ = -1;
};

TEST(StopTest, OnlyAnExactLineReleasesItAndEverythingElsePresses) {
  const int domain = test::OwnDomain();
  dds::Participant robot({.domain = domain});
  dds::EmergencyStopReceiver receiver(robot, 1.0);
  const TypedStop stop(domain);
  ASSERT_TRUE(Becomes(receiver, EmergencyStop::kClear));
  const auto released = [&] {
    stop.Type("r\n");
    for (int i = 0; i < 3000; ++i) {
      receiver.Acknowledge();
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
      const auto now_ns = Clock::now().time_since_epoch().count();
      if (receiver.Check(now_ns) == EmergencyStop::kClear) return true;
    }
    return false;
  };
  for (const char* typed : {"\n", "x\n", "stop the robot\n", "R\n", " r\n", "rr\n", "quick\n",
                            "\xff\xfe\n", "r\n\n", "release\n"}) {
    SCOPED_TRACE(typed);
    stop.Type(typed);
    EXPECT_TRUE(Becomes(receiver, EmergencyStop::kPressed));
    receiver.Acknowledge();
    EXPECT_TRUE(Becomes(receiver, EmergencyStop::kPressed)) << "it was released at once";
    EXPECT_TRUE(released());
  }
}

}  // namespace
}  // namespace dfr
