// Access of the runtime to the machine: clocks, scheduler and terminal.
#include <gtest/gtest.h>
#include <poll.h>
#include <pty.h>
#include <sched.h>
#include <sys/mman.h>
#include <unistd.h>

#include <ctime>
#include <optional>
#include <string>
#include <thread>

#include "dfr/runtime/keyboard.h"
#include "dfr/runtime/periodic_timer.h"
#include "tests/support/eventually.h"

namespace dfr::runtime {
namespace {

TEST(MachineTest, ATimerNeverWakesEarly) {
  const std::int64_t start_ns = SteadyNow();
  PeriodicTimer timer(0.0005);
  for (int i = 1; i <= 20; ++i) {
    timer.Wait();
    EXPECT_GE(SteadyNow() - start_ns, i * 500'000) << "period " << i;
  }
}

TEST(MachineTest, TheWallClockIsInNanoseconds) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  const std::int64_t before = std::time(nullptr);
  const std::int64_t now_ns = WallNow();
  EXPECT_GE(now_ns, before * kSecond);
  EXPECT_LE(now_ns, (std::time(nullptr) + 2) * kSecond);
}

// The user's rights decide the outcome. The program continues in both cases and learns the outcome.
TEST(MachineTest, RealTimeIsGrantedOrTheMissingRightIsNamed) {
  std::string refused;
  int granted = -1;
  std::thread([&] {
    refused = AskForRealTime(1);
    granted = sched_getscheduler(0);
    GiveUpRealTime();
    EXPECT_EQ(sched_getscheduler(0), SCHED_OTHER);
  }).join();
  munlockall();
  EXPECT_EQ(granted == SCHED_FIFO, refused.find("no real-time scheduling") == std::string::npos)
      << refused;
}

TEST(MachineTest, TerminalInputBeforeAQuestionIsDiscarded) {
  const auto type = [](int file, const std::string& text) {
    ASSERT_EQ(::write(file, text.data(), text.size()), static_cast<ssize_t>(text.size()));
  };
  int master = -1;
  int slave = -1;
  ASSERT_EQ(::openpty(&master, &slave, nullptr, nullptr, nullptr), 0);
  Keyboard keyboard(slave);
  type(master, "\n\nhalf a line");
  pollfd typed{slave, POLLIN, 0};
  test::Eventually([&] { return ::poll(&typed, 1, 0) == 1; });
  keyboard.Discard();
  type(master, "start\n");
  std::optional<std::string> line;
  test::Eventually([&] { return (line = keyboard.Line()).has_value(); });
  EXPECT_EQ(line, "start");
  EXPECT_FALSE(keyboard.Line());
  ::close(slave);
  ::close(master);
}

}  // namespace
}  // namespace dfr::runtime
