#include "dfr/core/text/format.h"

#include <gtest/gtest.h>

#include <string>
#include <string_view>

#include "dfr/core/text/take_until.h"

namespace dfr::core {
namespace {

TEST(TakeUntilTest, RemovesTheItemAndItsSeparator) {
  std::string_view text = "a,,bc";
  for (const char* item : {"a", "", "bc", ""}) EXPECT_EQ(TakeUntil(text, ','), item);
  EXPECT_TRUE(text.empty());
  text = ",";
  EXPECT_EQ(TakeUntil(text, ','), "");
  EXPECT_TRUE(text.empty());
}

TEST(FormatTest, CutsNothing) {
  const std::string text(5000, 'x');
  EXPECT_EQ(Format("<%s>", text.c_str()), "<" + text + ">");
}

TEST(FormatTest, PrintableTextCannotControlATerminal) {
  EXPECT_EQ(Printable("tip \x1b[2J\r\x7f \xc2\x9b"
                      "1m \xc3\xa9 \xe2\x82\xac\n"),
            "tip \\x1b[2J\\x0d\\x7f \\xc2\\x9b"
            "1m \xc3\xa9 \xe2\x82\xac\n");
  EXPECT_EQ(Printable(std::string_view("\0\xc2", 2)), "\\x00\xc2");
}

TEST(FormatTest, TextIsMadePrintableInPlace) {
  const std::string rude =
      "tip \x1b[2J\r\x7f \xc2\x9b"
      "1m \xc3\xa9\n\xc2";
  std::string text = rude;
  MakePrintable(text);
  EXPECT_EQ(text, "tip ?[2J?? ?\?1m \xc3\xa9?\xc2");
  text = rude;
  MakePrintable(text, /*keeps_lines=*/true);
  EXPECT_EQ(text, "tip ?[2J?? ?\?1m \xc3\xa9\n\xc2");
}

}  // namespace
}  // namespace dfr::core
