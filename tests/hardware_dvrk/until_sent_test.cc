#include "until_sent.h"

#include <gtest/gtest.h>

namespace dfr::hardware::internal {
namespace {

TEST(UntilSentTest, AMessageIsWantedUntilAWriteSucceeds) {
  UntilSent hold;
  int writes = 0;
  bool works = false;
  const auto write = [&] {
    ++writes;
    return works;
  };
  EXPECT_TRUE(hold.Send(write));
  EXPECT_EQ(writes, 0) << "nobody wants it";
  hold.Want();
  for (int attempt = 1; attempt <= 3; ++attempt) {
    EXPECT_FALSE(hold.Send(write));
    EXPECT_TRUE(hold.wanted());
    EXPECT_EQ(writes, attempt);
  }
  works = true;
  EXPECT_TRUE(hold.Send(write));
  EXPECT_FALSE(hold.wanted());
  EXPECT_TRUE(hold.Send(write));
  EXPECT_EQ(writes, 4) << "it is sent once";
}

// A wish during the write is a wish for another message.
TEST(UntilSentTest, AWishDuringAWriteIsKept) {
  UntilSent hold;
  hold.Want();
  EXPECT_TRUE(hold.Send([&] {
    hold.Want();
    return true;
  }));
  EXPECT_TRUE(hold.wanted());
}

}  // namespace
}  // namespace dfr::hardware::internal
