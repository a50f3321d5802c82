#include "dfr/core/text/format.h"

#include <gtest/gtest.h>

#include <string>

namespace dfr::core {
namespace {

TEST(FormatTest, CutsNothing) {
  const std::string text(5000, 'x');
  EXPECT_EQ(Format("<%s>", text.c_str()), "<" + text + ">");
}

}  // namespace
}  // namespace dfr::core
