#include "dfr/core/files/read_file.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>

#include "dfr/core/files/archive.h"
#include "dfr/core/files/toml_text.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::core {
namespace {

// A file that opens normally, but whose first read fails, as on a failing disk.
constexpr char kUnreadable[] = "/proc/self/mem";

template <typename Read>
std::string ErrorOf(const Read& read) {
  return test::MessageOf<std::runtime_error>([&] { static_cast<void>(read()); });
}

TEST(ReadFileTest, ReturnsEveryByte) {
  const test::TempFolder folder;
  std::string content(200'000, '\0');
  for (std::size_t i = 0; i < content.size(); ++i) content[i] = static_cast<char>(i * 7);
  std::ofstream(folder / "bytes", std::ios::binary) << content;
  EXPECT_EQ(ReadFile(folder / "bytes"), content);
  std::ofstream(folder / "empty").close();
  EXPECT_EQ(ReadFile(folder / "empty"), "");
  EXPECT_EQ(ErrorOf([] { return ReadFile("/nonexistent"); }), "/nonexistent: cannot be read");
}

TEST(ReadFileTest, AFailingDiskIsAnError) {
  const std::string error = std::string(kUnreadable) + ": cannot be read to its end";
  EXPECT_EQ(ErrorOf([] { return ReadFile(kUnreadable); }), error);
  EXPECT_EQ(ErrorOf([] { return ReadTomlText(kUnreadable); }), error);
}

// Nothing writes to this pipe: opening it for reading would block.
TEST(ReadFileTest, APipeIsRefusedInsteadOfWaitingForIt) {
  const test::TempFolder folder;
  const std::filesystem::path pipe = folder / "pipe";
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  const std::string error = pipe.string() + ": is a pipe or a device, not a file";
  EXPECT_EQ(ErrorOf([&] { return ReadFile(pipe); }), error);
  EXPECT_EQ(ErrorOf([&] { return ArchiveReader(pipe, "sample", 1); }), error);
  EXPECT_EQ(ErrorOf([&] { return ReadFile(folder.path); }), folder.path.string() + ": is a folder");
}

}  // namespace
}  // namespace dfr::core
