#include "dfr/recording/records.h"

#include <gtest/gtest.h>

#include <array>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/support/no_alloc.h"
#include "tests/support/temp_folder.h"

namespace dfr::recording {
namespace {

void Write(const std::filesystem::path& file, const std::string& text) {
  std::filesystem::create_directories(file.parent_path());
  std::ofstream(file, std::ios::binary) << text;
}

TEST(TextTest, KeepsTheTextThatFits) {
  const test::NoAlloc guard;
  const Text<8> text = "holding";
  EXPECT_EQ(text.view(), "holding");
  EXPECT_EQ(Text<8>("faulted here").view(), "faulted ");
  EXPECT_EQ(Text<8>().view(), "");
}

TEST(NumbersTest, RefusesTooManyNumbers) {
  const std::array<double, 4> values = {1.0, 2.0, 3.0, 4.0};
  const test::NoAlloc guard;
  Numbers<3> numbers;
  EXPECT_TRUE(numbers.Assign(std::span(values).first(3)));
  EXPECT_EQ(numbers.view().size(), 3U);
  EXPECT_EQ(numbers.view()[2], 3.0);
  EXPECT_FALSE(numbers.Assign(values));
  EXPECT_TRUE(numbers.view().empty());
}

TEST(ChecksumTest, IsFnv1aOfAFile) {
  const test::TempFolder folder;
  Write(folder / "empty", "");
  EXPECT_EQ(Checksum(folder / "empty"), "cbf29ce484222325");
  Write(folder / "a", "a");
  EXPECT_EQ(Checksum(folder / "a"), "af63dc4c8601ec8c");  // published by the algorithm's authors
  EXPECT_THROW(static_cast<void>(Checksum(folder / "missing")), std::runtime_error);
}

TEST(ChecksumTest, ChecksumOfAFolderChangesWithNamesAndContents) {
  const test::TempFolder folder;
  Write(folder / "one/policy", "abc");
  Write(folder / "one/support/0", "de");
  const std::string one = Checksum(folder / "one");
  Write(folder / "two/support/0", "de");
  Write(folder / "two/policy", "abc");
  EXPECT_EQ(Checksum(folder / "two"), one);
  Write(folder / "two/policy", "abd");
  EXPECT_NE(Checksum(folder / "two"), one);
  Write(folder / "three/policy", "abc");
  Write(folder / "three/support/1", "de");
  EXPECT_NE(Checksum(folder / "three"), one);
}

}  // namespace
}  // namespace dfr::recording
