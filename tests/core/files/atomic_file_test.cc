#include "dfr/core/files/atomic_file.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <functional>
#include <set>
#include <sstream>
#include <stdexcept>
#include <string>

#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::core {
namespace {

using testing::HasSubstr;

class AtomicFileTest : public testing::Test {
 protected:
  AtomicFileTest()
      : folder_(dfr::test::ProcessFolder() /
                testing::UnitTest::GetInstance()->current_test_info()->name()) {
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  ~AtomicFileTest() override { std::filesystem::remove_all(folder_); }

  static std::string Content(const std::filesystem::path& path) {
    std::ifstream in(path, std::ios::binary);
    std::ostringstream bytes;
    bytes << in.rdbuf();
    return bytes.str();
  }
  static mode_t ModeOf(const std::filesystem::path& path) {
    struct stat found {};
    EXPECT_EQ(stat(path.c_str(), &found), 0);
    return found.st_mode & 07777;
  }
  static std::string Error(const std::function<void()>& call) {
    return dfr::test::MessageOf<std::runtime_error>([&] { call(); });
  }
  // Expects exactly this many files: no temporary file remains.
  void ExpectOnly(std::ptrdiff_t files) const {
    EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder_), {}), files);
  }

  std::filesystem::path folder_;
  std::filesystem::path file_ = folder_ / "file";
};

TEST_F(AtomicFileTest, ReplacesTheWholeContent) {
  ReplaceFile(file_, std::string(100'000, 'a'));
  ReplaceFile(file_, std::string("b\0c", 3));
  EXPECT_EQ(Content(file_), std::string("b\0c", 3));
  ExpectOnly(1);
}

TEST_F(AtomicFileTest, WithoutCommitTheFileIsUnchanged) {
  ReplaceFile(file_, "before");
  {
    AtomicFile file(file_);
    file.Write("after");
    EXPECT_EQ(Content(file_), "before");
  }
  EXPECT_EQ(Content(file_), "before");
  ExpectOnly(1);
}

TEST_F(AtomicFileTest, ASymbolicLinkStaysALink) {
  const auto target = folder_ / "target";
  const auto link = folder_ / "link";
  ReplaceFile(target, "before");
  std::filesystem::create_symlink("target", link);  // relative to the link's folder
  std::filesystem::create_symlink(link, folder_ / "second");
  ReplaceFile(folder_ / "second", "after");
  EXPECT_TRUE(std::filesystem::is_symlink(link));
  EXPECT_TRUE(std::filesystem::is_symlink(folder_ / "second"));
  EXPECT_FALSE(std::filesystem::is_symlink(target));
  EXPECT_EQ(Content(target), "after");
  ExpectOnly(3);
}

TEST_F(AtomicFileTest, ADanglingLinkCreatesItsTarget) {
  std::filesystem::create_symlink("new", folder_ / "link");
  ReplaceFile(folder_ / "link", "made");
  EXPECT_EQ(Content(folder_ / "new"), "made");
  EXPECT_TRUE(std::filesystem::is_symlink(folder_ / "link"));
}

TEST_F(AtomicFileTest, FollowsAsManyLinksAsTheKernel) {
  constexpr int kMostLinks = 40;
  const auto link = [this](int i) { return folder_ / std::to_string(i); };
  ReplaceFile(link(0), "before");
  for (int i = 1; i <= kMostLinks + 1; ++i) {
    std::filesystem::create_symlink(std::to_string(i - 1), link(i));
  }
  ASSERT_EQ(Content(link(kMostLinks)), "before") << "the kernel follows this many";
  ReplaceFile(link(kMostLinks), "after");
  EXPECT_EQ(Content(link(0)), "after");
  EXPECT_THAT(Error([&] { ReplaceFile(link(kMostLinks + 1), "x"); }),
              HasSubstr("cannot be written"));
  EXPECT_EQ(Content(link(0)), "after");
  for (int i = 1; i <= kMostLinks + 1; ++i) EXPECT_TRUE(std::filesystem::is_symlink(link(i)));
}

TEST_F(AtomicFileTest, ClosesItsFileAndNoOther) {
  const auto open_files = [] {
    std::set<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd")) {
      names.insert(entry.path().filename());
    }
    return names;
  };
  const auto before = open_files();
  ReplaceFile(file_, "x");
  EXPECT_EQ(open_files(), before);
  EXPECT_NE(Error([&] { ReplaceFile(folder_ / "absent" / "file", "x"); }), "nothing thrown");
  EXPECT_EQ(open_files(), before);
}

TEST_F(AtomicFileTest, TheModeIsKept) {
  ReplaceFile(file_, "before");
  for (const mode_t mode : {0600U, 0640U, 0664U, 0755U}) {
    ASSERT_EQ(chmod(file_.c_str(), mode), 0);
    ReplaceFile(file_, "after");
    EXPECT_EQ(ModeOf(file_), mode);
  }
}

TEST_F(AtomicFileTest, ANewFileHasTheModeThatTheUmaskLeaves) {
  const mode_t before = umask(0027);
  ReplaceFile(file_, "x");
  umask(before);
  EXPECT_EQ(ModeOf(file_), 0640U);
}

TEST_F(AtomicFileTest, ADeviceIsWrittenTo) {
  std::filesystem::path null = "/dev/null";
  std::filesystem::path full = "/dev/full";
  // A privileged process could replace the machine's devices: the test creates its own device.
  if (geteuid() == 0) {
    null = folder_ / "own_null";
    full = folder_ / "own_full";
    if (mknod(null.c_str(), S_IFCHR | 0600, makedev(1, 3)) != 0 ||
        mknod(full.c_str(), S_IFCHR | 0600, makedev(1, 7)) != 0 || !std::ofstream(null)) {
      GTEST_SKIP() << "no devices can be made in " << folder_;
    }
  }
  const auto link = folder_ / "null";
  std::filesystem::create_symlink(null, link);
  ReplaceFile(link, "gone");
  EXPECT_TRUE(std::filesystem::is_symlink(link));
  EXPECT_TRUE(std::filesystem::is_character_file(null));
  EXPECT_THAT(Error([&] { ReplaceFile(full, "too much"); }),
              testing::AllOf(HasSubstr(full.string()), HasSubstr("No space left")));
  EXPECT_TRUE(std::filesystem::is_character_file(full));
}

// A shell's redirection opens the file like this. After a rename the shell would write to a deleted
// file.
TEST_F(AtomicFileTest, AnOpenFileIsWrittenTo) {
  const auto path = folder_ / "redirected";
  const int out = open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
  ASSERT_GE(out, 0);
  ReplaceFile("/proc/self/fd/" + std::to_string(out), "first ");
  ASSERT_EQ(lseek(out, 0, SEEK_END), 6);
  ASSERT_EQ(write(out, "then", 4), 4);
  close(out);
  EXPECT_EQ(Content(path), "first then");
}

TEST_F(AtomicFileTest, APipeIsWrittenTo) {
  const auto path = folder_ / "pipe";
  ASSERT_EQ(mkfifo(path.c_str(), 0600), 0);
  const int reader = open(path.c_str(), O_RDONLY | O_NONBLOCK);
  ASSERT_GE(reader, 0);
  ReplaceFile(path, "through");
  std::array<char, 16> buffer{};
  EXPECT_EQ(read(reader, buffer.data(), buffer.size()), 7);
  EXPECT_EQ(std::string(buffer.data()), "through");
  close(reader);
  EXPECT_TRUE(std::filesystem::is_fifo(path));
}

TEST_F(AtomicFileTest, FoldersAndMissingFoldersAreErrors) {
  EXPECT_THAT(Error([&] { ReplaceFile(folder_, "x"); }), HasSubstr("Is a directory"));
  EXPECT_THAT(Error([&] { ReplaceFile(folder_ / "no" / "file", "x"); }),
              testing::AllOf(HasSubstr("no/file"), HasSubstr("No such file")));
}

TEST_F(AtomicFileTest, AReadOnlyFileIsNotReplaced) {
  if (geteuid() == 0) GTEST_SKIP() << "root may write every file";
  ReplaceFile(file_, "before");
  ASSERT_EQ(chmod(file_.c_str(), 0444), 0);
  EXPECT_THAT(Error([&] { ReplaceFile(file_, "after"); }), HasSubstr("Permission denied"));
  EXPECT_EQ(Content(file_), "before");
}

// A limit on file sizes stands in for a disk that is full after 0, 1 or 99 of 100 bytes.
TEST_F(AtomicFileTest, AFullDiskKeepsThePreviousFile) {
  ReplaceFile(file_, "before");
  rlimit unlimited{};
  getrlimit(RLIMIT_FSIZE, &unlimited);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  for (const rlim_t size : {0U, 1U, 99U}) {
    const rlimit small{size, unlimited.rlim_max};
    setrlimit(RLIMIT_FSIZE, &small);
    const std::string error = Error([&] { ReplaceFile(file_, std::string(100, 'x')); });
    setrlimit(RLIMIT_FSIZE, &unlimited);
    EXPECT_THAT(error, HasSubstr("cannot be written")) << size;
    EXPECT_EQ(Content(file_), "before") << size;
    ExpectOnly(1);
  }
  std::signal(SIGXFSZ, handler);
}

}  // namespace
}  // namespace dfr::core
