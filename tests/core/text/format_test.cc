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

TEST(FormatTest, PrintableTextIsUtf8AndCannotControlATerminal) {
  EXPECT_EQ(Printable("tip \x1b[2J\r\x7f \xc2\x9b"
                      "1m \xc3\xa9 \xe2\x82\xac\n"),
            "tip \\x1b[2J\\x0d\\x7f \\xc2\\x9b"
            "1m \xc3\xa9 \xe2\x82\xac\n");
  EXPECT_EQ(Printable(std::string_view("\0\xc2", 2)), "\\x00\\xc2");
  EXPECT_EQ(Printable("\xff\xe2\x82"
                      "a\xc3\xa9"),
            "\\xff\\xe2\\x82"
            "a\xc3\xa9");
}

TEST(FormatTest, KnowsUtf8) {
  // The first and the last character of each size, and the neighbours of the surrogates.
  for (const char* text : {"", "a\x7f", "\xc2\x80\xdf\xbf", "\xe0\xa0\x80\xef\xbf\xbf",
                           "\xed\x9f\xbf\xee\x80\x80", "\xf0\x90\x80\x80\xf4\x8f\xbf\xbf"}) {
    EXPECT_TRUE(IsUtf8(text)) << Printable(text);
  }
  // Lone and missing bytes, longer forms, a surrogate, and a number beyond U+10FFFF.
  for (const char* text :
       {"a\x80", "\xff", "\xc3",
        "\xc3"
        "a",
        "\xe2\x82", "\xf0\x9f\x98", "\xc1\xbf", "\xe0\x9f\xbf", "\xf0\x8f\xbf\xbf", "\xed\xa0\x80",
        "\xf4\x90\x80\x80", "\xf5\x80\x80\x80"}) {
    EXPECT_FALSE(IsUtf8(text)) << Printable(text);
  }
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
