#include "dfr/core/format.h"

#include <gtest/gtest.h>

#include <string>

namespace dfr::core {
namespace {

TEST(FormatTest, PrintsAsPrintfDoes) {
  EXPECT_EQ(Format("%s: %.2f of %d (%.1f %%)", "inside", 1.005, 3, 33.333),
            "inside: 1.00 of 3 (33.3 %)");
  EXPECT_EQ(Format("%-6s|%+.*f", "ab", 1, -0.25), "ab    |-0.2");
  EXPECT_EQ(Format("%s", ""), "");
}

TEST(FormatTest, CutsNothing) {
  const std::string text(5000, 'x');
  EXPECT_EQ(Format("<%s>", text.c_str()), "<" + text + ">");
}

}  // namespace
}  // namespace dfr::core
