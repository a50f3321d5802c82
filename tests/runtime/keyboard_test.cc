#include "dfr/runtime/keyboard.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <string>

#include "tests/runtime/pipe.h"

namespace dfr::runtime {
namespace {

class KeyboardTest : public testing::Test {
 protected:
  test::Pipe typed_;
  Keyboard keyboard_{typed_.in()};
};

TEST_F(KeyboardTest, LinesArriveCompleteAndInOrder) {
  EXPECT_FALSE(keyboard_.Line());
  typed_.Type("sta");
  EXPECT_FALSE(keyboard_.Line());
  typed_.Type("rt\n\nr\n");
  EXPECT_EQ(keyboard_.Line(), "start");
  EXPECT_EQ(keyboard_.Line(), "");
  EXPECT_EQ(keyboard_.Line(), "r");
  EXPECT_FALSE(keyboard_.Line());
  EXPECT_FALSE(keyboard_.ended());
  typed_.CloseOut();
  EXPECT_FALSE(keyboard_.Line());
  EXPECT_TRUE(keyboard_.ended());
}

TEST_F(KeyboardTest, InputTypedBeforeAQuestionIsDiscarded) {
  typed_.Type("first\nhalf");
  EXPECT_EQ(keyboard_.Line(), "first");
  typed_.Type(" a line\n\n\n\n");
  keyboard_.Discard();
  EXPECT_FALSE(keyboard_.Line());
  typed_.Type("now\n");
  EXPECT_EQ(keyboard_.Line(), "now");
}

TEST(EndlessKeyboardTest, EndlessInputCountsAsEnded) {
  const int zeros = ::open("/dev/zero", O_RDONLY);
  Keyboard keyboard(zeros);
  keyboard.Discard();
  EXPECT_TRUE(keyboard.ended());
  ::close(zeros);
}

TEST_F(KeyboardTest, ALongLineIsTruncatedAndDoesNotShortenTheNext) {
  for (const int parts : {16, 20}) {
    for (int i = 0; i < parts; ++i) {
      typed_.Type(std::string(256, 'x'));
      EXPECT_FALSE(keyboard_.Line());
    }
    typed_.Type("\nstop\n");
    EXPECT_EQ(keyboard_.Line()->size(), 4096U);
    EXPECT_EQ(keyboard_.Line(), "stop");
  }
}

}  // namespace
}  // namespace dfr::runtime
