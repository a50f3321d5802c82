#include "tests/dds/peer_process.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>

namespace dfr::test {
namespace {

// The pipe is open while either the killed test or its child program lives.
TEST(PeerProcessTest, EndsWithATestThatIsKilled) {
  std::array<int, 2> ends{};
  ASSERT_EQ(::pipe(ends.data()), 0);
  const pid_t killed = ::fork();
  if (killed == 0) {
    const PeerProcess program({"/bin/sleep", "600"});
    if (::write(ends[1], "x", 1) == 1) ::pause();
    ::_exit(1);
  }
  ::close(ends[1]);
  char letter = 0;
  ASSERT_EQ(::read(ends[0], &letter, 1), 1);
  ::kill(killed, SIGKILL);
  ::waitpid(killed, nullptr, 0);
  EXPECT_EQ(::read(ends[0], &letter, 1), 0) << "waits for its end";
  ::close(ends[0]);
}

}  // namespace
}  // namespace dfr::test
