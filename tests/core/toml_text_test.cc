#include "dfr/core/toml_text.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>
#include <string>
#include <string_view>

namespace dfr::core {
namespace {

std::string Error(std::string_view text) {
  try {
    static_cast<void>(CheckToml("run.toml", text));
  } catch (const std::runtime_error& e) {
    return e.what();
  }
  return "";
}

TEST(TomlTextTest, CharactersBeyondAsciiMayStandInQuotesAndComments) {
  for (const char* text :
       {"", "a = 1\n", "# \xC3\xA9t\xC3\xA9\na = 1", "a = \"\xC3\xA9\" # \xC3\xA9",
        "'\xCF\x8F' = 1", "a = \"\\\"\xC3\xA9\"", "a = \"\"\"\n\xC3\xA9 \" \\\" \xC3\xA9\"\"\"",
        "a = '''\xC3\xA9''\n'''", "a = \"\"\nb = ''", "\xEF\xBB\xBF# a", "a = 'open"}) {
    EXPECT_EQ(Error(text), "") << text;
  }
}

// toml++ 3.3 asks of characters beyond ASCII in a malformed value what it cannot answer.
TEST(TomlTextTest, TheParserSeesAsciiThatMeansTheSame) {
  const auto ascii = [](std::string_view text) { return CheckToml("run.toml", text); };
  EXPECT_EQ(ascii("a = \"x\\\"\xC3\xA9\" # \xC3\xA9t\n"), "a = \"x\\\"\\u00e9\" # t\n");
  EXPECT_EQ(ascii("'\xCF\x8F\\\"' = 1"), "\"\\u03cf\\\\\\\"\" = 1");
  EXPECT_EQ(ascii("a = '''\n\xF0\x9F\x98\x80'''\n"), "a = \"\"\"\n\\U0001f600\"\"\"\n");
  EXPECT_EQ(ascii("a = \"\\\xC3\xA9\""), "a = \"\\?\\u00e9\"") << "stays wrong";
  EXPECT_EQ(ascii("a = 'C:\\x' # y"), "a = 'C:\\x' # y") << "as it is";
}

TEST(TomlTextTest, ElsewhereTheirLineIsNamed) {
  EXPECT_THAT(Error("\xCF\x8F"), testing::StartsWith("run.toml:1: a character beyond ASCII"));
  EXPECT_THAT(Error("a = 1\n\xCF\x8F = 2\n"),
              testing::StartsWith("run.toml:2: a character beyond ASCII"));
  EXPECT_THAT(Error("a = 'x' # y\nb = \xC3\xA9"),
              testing::StartsWith("run.toml:2: a character beyond ASCII"));
  EXPECT_THAT(Error("a = '\\'\n\xC3\xA9"),
              testing::StartsWith("run.toml:2: a character beyond ASCII"))
      << "no escapes in literal strings";
  EXPECT_THAT(Error("a = 'open\n\xC3\xA9"),
              testing::StartsWith("run.toml:2: a character beyond ASCII"));
  EXPECT_THAT(Error("a = \"\"\"x\"\"\"\n\xC3\xA9"),
              testing::StartsWith("run.toml:2: a character beyond ASCII"));
  EXPECT_THAT(Error("a = \"\"\"\n\"\"\"\"\n\n\xC3\xA9"),
              testing::StartsWith("run.toml:4: a character beyond ASCII"));
}

TEST(TomlTextTest, TablesHaveTheirNamesInOneLine) {
  for (const char* text :
       {"[a]\n", "  [ a . b ]", "[[a]]", "a = [\n  [\n 1],\n[2]\n]\n[b]", "a = {b = [\n]}"}) {
    EXPECT_EQ(Error(text), "") << text;
  }
  for (const char* text : {"\n[\nk]", "\n[", "\n  [[ \r\nk]]", "\n[ # k\n]", "#\n[\n\n]", "\n[[[a",
                           "\n[%]", "\n[ [a]]", "\n[]"}) {
    EXPECT_THAT(Error(text), testing::StartsWith("run.toml:2: the name of a table")) << text;
  }
}

TEST(TomlTextTest, QuotesBeginValuesAndNames) {
  for (const char* text : {"a=\"x\"", "a = ['x','y']", "a.'b'.\"c\" = {'d'='e'}", "\"a\" = 1"}) {
    EXPECT_EQ(Error(text), "") << text;
  }
  for (const char* text : {"\na = 9\"x\xC3\xA9\"", "\na'b' = 1", "\na = 'b''c'"}) {
    EXPECT_THAT(Error(text), testing::StartsWith("run.toml:2: a quote must not")) << text;
  }
}

TEST(TomlTextTest, WhatIsNoTextIsRefused) {
  EXPECT_EQ(
      Error("a = 1\n\x01"),
      "run.toml:2: there is the control character 1; is this a configuration, and is it whole?");
  for (const char* broken : {"# \xC3", "# \x80", "# \xF8\x80", "# \xE0\x80"}) {
    EXPECT_THAT(Error(broken), testing::HasSubstr("not UTF-8")) << broken;
  }
  EXPECT_THAT(Error(std::string((1U << 20U) + 1, '\n')), testing::HasSubstr("mebibyte"));
}

}  // namespace
}  // namespace dfr::core
