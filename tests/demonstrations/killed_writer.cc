#include "tests/demonstrations/killed_writer.h"

#include <gtest/gtest.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <stdexcept>

#include "dfr/imitation/demonstrations.h"
#include "tests/demonstrations/episodes.h"
#include "tests/support/temp_folder.h"

namespace {

// number of writes until the process kills itself; -1: unlimited
int writes_left = -1;  // NOLINT(cppcoreguidelines-avoid-non-const-global-variables)

void CountWrite() {
  if (writes_left == 0) raise(SIGKILL);
  if (writes_left > 0) --writes_left;
}

}  // namespace

// These functions replace the C library's, including for libhdf5.
extern "C" ssize_t pwrite64(int file, const void* bytes, size_t size, off64_t offset) {
  CountWrite();
  return syscall(SYS_pwrite64, file, bytes, size, offset);
}
extern "C" ssize_t pwrite(int file, const void* bytes, size_t size, off_t offset) {
  CountWrite();
  return syscall(SYS_pwrite64, file, bytes, size, offset);
}

namespace dfr::test {
namespace {

using imitation::DemonstrationReader;
using imitation::DemonstrationSet;
using imitation::RobomimicWriter;

constexpr int kEpisodes = 10;  // more entries than libhdf5 keeps in one piece of a list

// Appends kEpisodes episodes in a child that kills itself at the given write. Returns the number of
// acknowledged episodes, and sets `done` if the child completed.
template <typename MakeWriter>
int AppendUntilKilled(int writes, const MakeWriter& make_writer, bool* done) {
  int pipe_ends[2];
  if (pipe(pipe_ends) != 0) throw std::runtime_error("no pipe");
  const pid_t child = fork();
  if (child == 0) {
    writes_left = writes;
    auto writer = make_writer();
    for (int i = 0; i < kEpisodes; ++i) {
      writer.Append(Episode(i % 3));
      const char acknowledged = 'a';
      if (write(pipe_ends[1], &acknowledged, 1) != 1) _exit(2);
    }
    writer.CountDiscarded();
    // Skips the destructor, on which acknowledged data must not depend.
    _exit(0);
  }
  close(pipe_ends[1]);
  int acknowledged = 0;
  char byte = 0;
  while (read(pipe_ends[0], &byte, 1) == 1) ++acknowledged;
  close(pipe_ends[0]);
  int status = 0;
  waitpid(child, &status, 0);
  *done = WIFEXITED(status) && WEXITSTATUS(status) == 0;
  EXPECT_TRUE(*done || (WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL)) << status;
  return acknowledged;
}

void ExpectWhole(const DemonstrationReader& reader, int acknowledged) {
  ASSERT_GE(reader.num_episodes(), acknowledged);
  EXPECT_LE(reader.num_episodes(), acknowledged + 1);
  for (int i = 0; i < reader.num_episodes(); ++i) {
    const core::Trajectory episode = reader.Read(i);
    const core::Trajectory expected = Episode(i % 3);
    ASSERT_EQ(episode.states.rows(), expected.states.rows());
    ASSERT_EQ(episode.states, expected.states);
    ASSERT_EQ(episode.controls, expected.controls);
  }
}

}  // namespace

void ExpectNoEpisodeLost(int step, int least) {
  const TempFolder folder;
  const std::filesystem::path path = folder / "demos.hdf5";
  const DemonstrationSet set = Episodes();
  bool done = false;
  int kills = -1;  // the last run completes
  for (int writes = 0; !done; writes += step, ++kills) {
    SCOPED_TRACE(testing::Message() << "killed at write " << writes);
    const int acknowledged = AppendUntilKilled(
        writes, [&] { return RobomimicWriter(path, set.layout, 2, set.environment); }, &done);
    if (acknowledged > 0) ExpectWhole(*imitation::OpenRobomimic(path), acknowledged);
    if (testing::Test::HasFailure()) return;
  }
  EXPECT_EQ(imitation::LoadRobomimic(path).discarded, 1);
  EXPECT_GE(kills, least);
}

}  // namespace dfr::test
