#include "dfr/core/files/archive.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <sstream>
#include <stdexcept>

#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::core {
namespace {

using testing::HasSubstr;

class ArchiveTest : public testing::Test {
 protected:
  ArchiveTest()
      : folder_(dfr::test::ProcessFolder() /
                testing::UnitTest::GetInstance()->current_test_info()->name()) {
    std::filesystem::create_directories(folder_);
  }
  ~ArchiveTest() override { std::filesystem::remove_all(folder_); }

  std::filesystem::path File(const char* name = "values.dfr") const { return folder_ / name; }

  static ArchiveWriter Sample() {
    ArchiveWriter writer("sample", 2);
    writer.Integer(-7);
    writer.Number(0.1);
    writer.Text("object,tip");
    writer.Numbers(std::vector<double>{1.5, std::numeric_limits<double>::infinity()});
    writer.Integers(std::vector<int>{3, -4});
    Matrix m(2, 3);
    m << 1, 2, 3, 4, 5, 6;
    writer.MatrixBlock(m);
    return writer;
  }

  std::string Content() const {
    std::ostringstream out;
    out << std::ifstream(File(), std::ios::binary).rdbuf();
    return out.str();
  }

  void Replace(const std::string& content) const {
    std::ofstream(File(), std::ios::binary | std::ios::trunc) << content;
  }

  static std::string Error(const std::function<void()>& run) {
    return dfr::test::MessageOf<std::runtime_error>([&] { run(); });
  }

 private:
  std::filesystem::path folder_;
};

TEST_F(ArchiveTest, ReturnsWhatWasWritten) {
  Sample().Save(File());
  ArchiveReader reader(File(), "sample", 2);
  EXPECT_EQ(reader.Integer(), -7);
  EXPECT_EQ(reader.Number(), 0.1);
  EXPECT_EQ(reader.Text(), "object,tip");
  EXPECT_THAT(reader.Numbers(), testing::ElementsAre(1.5, std::numeric_limits<double>::infinity()));
  EXPECT_THAT(reader.Integers(), testing::ElementsAre(3, -4));
  const Matrix m = reader.MatrixBlock();
  EXPECT_EQ(m(1, 2), 6.0);
  EXPECT_EQ(m.rows(), 2);
  reader.End();
}

TEST_F(ArchiveTest, EveryTruncationIsRefused) {
  Sample().Save(File());
  const std::string whole = Content();
  for (std::size_t size = 0; size < whole.size(); ++size) {
    Replace(whole.substr(0, size));
    EXPECT_THROW(ArchiveReader(File(), "sample", 2), std::runtime_error) << size << " bytes";
  }
}

TEST_F(ArchiveTest, EveryFlippedBitIsRefused) {
  Sample().Save(File());
  const std::string whole = Content();
  std::fstream file(File(), std::ios::in | std::ios::out | std::ios::binary);
  const auto set = [&](std::size_t byte, char value) {
    file.seekp(static_cast<std::streamoff>(byte)).put(value).flush();
  };
  for (std::size_t i = 0; i < whole.size() * 8; ++i) {
    const char right = whole[i / 8];
    set(i / 8, static_cast<char>(right ^ (1 << (i % 8))));
    EXPECT_THROW(ArchiveReader(File(), "sample", 2), std::runtime_error) << "bit " << i;
    set(i / 8, right);
  }
  EXPECT_EQ(Content(), whole);
}

TEST_F(ArchiveTest, ErrorsNameFileAndReason) {
  EXPECT_THAT(Error([&] { ArchiveReader(File("absent.dfr"), "sample", 2); }),
              testing::AllOf(HasSubstr("absent.dfr"), HasSubstr("No such file")));
  Sample().Save(File());
  EXPECT_THAT(Error([&] { ArchiveReader(File(), "policy", 2); }),
              HasSubstr("is a sample file, but a policy file is needed"));
  for (const int other : {1, 3}) {
    EXPECT_THAT(Error([&] { ArchiveReader(File(), "sample", other); }),
                HasSubstr("is a sample file of version 2; this program reads version " +
                          std::to_string(other) + ": fit it again"));
  }
  EXPECT_THAT(Error([&] { ArchiveReader(File(), "sample", 2).Number(); }),
              testing::AllOf(HasSubstr("type 'i' at byte"), HasSubstr(", where 'd' is needed")));
  EXPECT_THAT(Error([&] { ArchiveReader(File(), "sample", 2).End(); }),
              HasSubstr("bytes after its last value"));
  EXPECT_THAT(Error([&] { ArchiveReader(File(), "sample", 2).IntegerIn(0, 5); }),
              HasSubstr("-7 where one in [0, 5]"));
  EXPECT_THAT(Error([&] { ArchiveReader(File(), "sample", 2).IntegerIn(-20, -8); }),
              HasSubstr("-7 where one in [-20, -8]"));
  EXPECT_EQ(ArchiveReader(File(), "sample", 2).IntegerIn(-20, -7), -7);
  EXPECT_EQ(ArchiveReader(File(), "sample", 2).IntegerIn(-7, 0), -7);
  Replace("some text that is longer than a header would be");
  EXPECT_THAT(Error([&] { ArchiveReader(File(), "sample", 2); }), HasSubstr("not a file written"));
}

// /dev/zero has no end.
TEST_F(ArchiveTest, OtherFilesAreNotReadToTheirEnd) {
  EXPECT_THAT(Error([] { ArchiveReader("/dev/zero", "sample", 2); }),
              HasSubstr("/dev/zero: is a pipe or a device, not a file"));
}

// Bytes of a file in a message must not control the terminal or make the message too long.
TEST_F(ArchiveTest, ErrorsQuoteOnlyShortPrintableText) {
  ArchiveWriter("\x1b[2J\xff" + std::string(1000, 'k'), 1).Save(File());
  EXPECT_THAT(Error([&] { ArchiveReader(File(), "sample", 1); }),
              HasSubstr("is a ?[2J?" + std::string(35, 'k') + " file, but a sample file"));
}

// A hostile file with a valid checksum must not make the reader allocate the declared size.
TEST_F(ArchiveTest, AnnouncedSizesAreCheckedAgainstTheFile) {
  ArchiveWriter writer("sample", 1);
  writer.Numbers(std::vector<double>{1.0});
  writer.Save(File());
  std::string content = Content();
  const std::size_t size_at = content.size() - 8 - 8 - 8;  // checksum, one number and the size
  content[size_at + 6] = 1;
  content.resize(content.size() - 8);
  std::uint64_t hash = 0xcbf29ce484222325u;
  for (const char c : content) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
  content.append(reinterpret_cast<const char*>(&hash), 8);
  Replace(content);
  EXPECT_THAT(Error([&] { ArchiveReader(File(), "sample", 1).Numbers(); }),
              HasSubstr("does not contain them"));
}

// A small file must not request gigabytes. A large file may request memory of its size.
TEST_F(ArchiveTest, AllocationIsBoundedByTheFileSize) {
  Sample().Save(File());
  ArchiveReader reader(File(), "sample", 2);
  reader.Spend(1000, 8, "things");
  EXPECT_THAT(Error([&] { reader.Spend(std::uint64_t{1} << 32, 8, "weights"); }),
              testing::AllOf(HasSubstr("values.dfr"), HasSubstr("4294967296 weights of 8 bytes")));
  EXPECT_THAT(Error([&] { reader.Spend(std::uint64_t{1} << 62, 16, "weights"); }),
              HasSubstr("too many for a file of"));
}

// A limit on file sizes stands in for a full disk: the write, not the creation, fails.
TEST_F(ArchiveTest, AFullDiskIsReportedAndKeepsThePreviousFile) {
  Sample().Save(File());
  const std::string before = Content();
  rlimit unlimited{};
  getrlimit(RLIMIT_FSIZE, &unlimited);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{100, unlimited.rlim_max};
  setrlimit(RLIMIT_FSIZE, &small);
  const std::string error = Error([&] { Sample().Save(File()); });
  setrlimit(RLIMIT_FSIZE, &unlimited);
  std::signal(SIGXFSZ, handler);
  EXPECT_THAT(error, HasSubstr("values.dfr: cannot be written"));
  EXPECT_EQ(Content(), before);
}

}  // namespace
}  // namespace dfr::core
