#include "dfr/runtime/keyboard.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <string>
#include <string_view>

namespace dfr::runtime {
namespace {

void Type(int file, std::string_view text) {
  ASSERT_EQ(::write(file, text.data(), text.size()), static_cast<ssize_t>(text.size()));
}

class KeyboardTest : public testing::Test {
 protected:
  KeyboardTest() { EXPECT_EQ(::pipe(ends_.data()), 0); }
  ~KeyboardTest() override {
    ::close(ends_[0]);
    if (ends_[1] >= 0) ::close(ends_[1]);
  }

  std::array<int, 2> ends_{};
};

TEST_F(KeyboardTest, LinesArriveCompleteAndInOrder) {
  Keyboard keyboard(ends_[0]);
  EXPECT_FALSE(keyboard.Line());
  Type(ends_[1], "sta");
  EXPECT_FALSE(keyboard.Line());
  Type(ends_[1], "rt\n\nr\n");
  EXPECT_EQ(keyboard.Line(), "start");
  EXPECT_EQ(keyboard.Line(), "");
  EXPECT_EQ(keyboard.Line(), "r");
  EXPECT_FALSE(keyboard.Line());
  EXPECT_FALSE(keyboard.ended());
  ::close(ends_[1]);
  ends_[1] = -1;
  EXPECT_FALSE(keyboard.Line());
  EXPECT_TRUE(keyboard.ended());
}

TEST_F(KeyboardTest, InputTypedBeforeAQuestionIsDiscarded) {
  Keyboard keyboard(ends_[0]);
  Type(ends_[1], "first\nhalf");
  EXPECT_EQ(keyboard.Line(), "first");
  Type(ends_[1], " a line\n\n\n\n");
  keyboard.Discard();
  EXPECT_FALSE(keyboard.Line());
  Type(ends_[1], "now\n");
  EXPECT_EQ(keyboard.Line(), "now");
}

TEST_F(KeyboardTest, ALineWithoutAnEndIsTruncated) {
  Keyboard keyboard(ends_[0]);
  for (int i = 0; i < 1000; ++i) {
    Type(ends_[1], std::string(256, 'x'));
    EXPECT_FALSE(keyboard.Line());
  }
  Type(ends_[1], "\n");
  EXPECT_EQ(keyboard.Line()->size(), 4096U);
}

TEST_F(KeyboardTest, ALongLineDoesNotShortenTheNext) {
  Keyboard keyboard(ends_[0]);
  for (int i = 0; i < 16; ++i) {
    Type(ends_[1], std::string(256, 'x'));
    EXPECT_FALSE(keyboard.Line());
  }
  Type(ends_[1], "\nstop\n");
  EXPECT_EQ(keyboard.Line()->size(), 4096U);
  EXPECT_EQ(keyboard.Line(), "stop");
}

}  // namespace
}  // namespace dfr::runtime
