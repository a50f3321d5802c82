// The main() of tests over DDS. What they test keeps deadlines of the wall clock: a state that is
// 50 ms old ends in hold, as it has to, also where the machine alone made it late. So each core is
// watched while a test runs, and a test that fails while a core stood still for longer than a third
// of that is run once more, in a new process. What fails three times has failed.

#include <gtest/gtest.h>
#include <sched.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <thread>
#include <vector>

namespace {

using Clock = std::chrono::steady_clock;
using Milliseconds = std::chrono::duration<double, std::milli>;

constexpr double kStall_ms = 50.0 / 3.0;
constexpr int kAttempts = 3;
constexpr const char* kAttempt = "DFR_TEST_ATTEMPT";

// The longest time for which a core let a thread wait that only wanted to look at the clock.
class StallWatch {
 public:
  StallWatch() {
    cpu_set_t allowed;
    CPU_ZERO(&allowed);
    if (::sched_getaffinity(0, sizeof allowed, &allowed) != 0) return;
    for (int core = 0; core < CPU_SETSIZE; ++core) {
      if (CPU_ISSET(core, &allowed)) threads_.emplace_back([this, core] { Watch(core); });
    }
  }
  ~StallWatch() { (void)End(); }
  StallWatch(const StallWatch&) = delete;
  StallWatch& operator=(const StallWatch&) = delete;

  double End() {
    stop_ = true;
    for (std::thread& thread : threads_) thread.join();
    threads_.clear();
    return longest_ms_;
  }

 private:
  void Watch(int core) {
    cpu_set_t here;
    CPU_ZERO(&here);
    CPU_SET(core, &here);
    (void)::sched_setaffinity(0, sizeof here, &here);
    auto last = Clock::now();
    while (!stop_) {
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
      const auto now = Clock::now();
      const double waited = Milliseconds(now - last).count() - 2.0;
      last = now;
      double longest = longest_ms_;
      while (waited > longest && !longest_ms_.compare_exchange_weak(longest, waited)) {
      }
    }
  }

  std::atomic<bool> stop_{false};
  std::atomic<double> longest_ms_{0.0};
  std::vector<std::thread> threads_;
};

}  // namespace

int main(int argc, char** argv) {
  const std::vector<char*> arguments(argv, argv + argc + 1);  // InitGoogleTest takes its own out
  testing::InitGoogleTest(&argc, argv);
  if (GTEST_FLAG_GET(list_tests)) return RUN_ALL_TESTS();
  StallWatch watch;
  const int failed = RUN_ALL_TESTS();
  const double stall_ms = watch.End();
  const char* text = std::getenv(kAttempt);
  const int attempt = text == nullptr ? 1 : std::max(1, std::atoi(text));
  if (failed == 0 || attempt >= kAttempts || stall_ms < kStall_ms) return failed;
  std::printf("a core stood still for %.0f ms while the test ran: attempt %d of %d\n", stall_ms,
              attempt + 1, kAttempts);
  std::fflush(stdout);
  (void)::setenv(kAttempt, std::to_string(attempt + 1).c_str(), 1);
  ::execv("/proc/self/exe", arguments.data());
  std::perror("execv");
  return failed;
}
