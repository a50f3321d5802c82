#include "dfr/core/files/toml_text.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>
#include <string>
#include <string_view>

#include "tests/support/message_of.h"

namespace dfr::core {
namespace {

std::string Error(std::string_view text) {
  return dfr::test::MessageOf<std::runtime_error>(
      [&] { static_cast<void>(CheckToml("run.toml", text)); });
}

TEST(TomlTextTest, CharactersBeyondAsciiMayStandInQuotesAndComments) {
  for (const char* text :
       {"", "a = 1\n", "# \xC3\xA9t\xC3\xA9\na = 1", "a = \"\xC3\xA9\" # \xC3\xA9",
        "'\xCF\x8F' = 1", "a = \"\\\"\xC3\xA9\"", "a = \"\"\"\n\xC3\xA9 \" \\\" \xC3\xA9\"\"\"",
        "a = '''\xC3\xA9''\n'''", "a = \"\"\nb = ''", "\xEF\xBB\xBF# a"}) {
    EXPECT_EQ(Error(text), "nothing thrown") << text;
  }
}

// toml++ 3.3 fails on characters beyond ASCII in a malformed value.
TEST(TomlTextTest, TheParserGetsEquivalentAscii) {
  const auto ascii = [](std::string_view text) { return CheckToml("run.toml", text); };
  EXPECT_EQ(ascii("a = \"x\\\"\xC3\xA9\" # \xC3\xA9t\n"), "a = \"x\\\"\\u00e9\" # t\n");
  EXPECT_EQ(ascii("'\xCF\x8F\\\"' = 1"), "\"\\u03cf\\\\\\\"\" = 1");
  EXPECT_EQ(ascii("a = '''\n\xF0\x9F\x98\x80'''\n"), "a = \"\"\"\n\\U0001f600\"\"\"\n");
  EXPECT_EQ(ascii("a = \"\\\xC3\xA9\""), "a = \"\\?\\u00e9\"") << "stays invalid";
  EXPECT_EQ(ascii("a = 'C:\\x' # y"), "a = 'C:\\x' # y") << "unchanged";
}

TEST(TomlTextTest, ElsewhereCharactersBeyondAsciiAreRefused) {
  EXPECT_THAT(Error("\xCF\x8F"), testing::StartsWith("run.toml:1: a character beyond ASCII"));
  EXPECT_THAT(Error("a = 1\n\xCF\x8F = 2\n"),
              testing::StartsWith("run.toml:2: a character beyond ASCII"));
  EXPECT_THAT(Error("a = 'x' # y\nb = \xC3\xA9"),
              testing::StartsWith("run.toml:2: a character beyond ASCII"));
  EXPECT_THAT(Error("a = '\\'\n\xC3\xA9"),
              testing::StartsWith("run.toml:2: a character beyond ASCII"))
      << "no escapes in literal strings";
  EXPECT_THAT(Error("a = \"\"\"x\"\"\"\n\xC3\xA9"),
              testing::StartsWith("run.toml:2: a character beyond ASCII"));
  EXPECT_THAT(Error("a = \"\"\"\n\"\"\"\"\n\n\xC3\xA9"),
              testing::StartsWith("run.toml:4: a character beyond ASCII"));
}

TEST(TomlTextTest, ParsesConfigurations) {
  for (const char* text : {"[a]\n",
                           "  [ a . b ]  # c\r\n",
                           "[[a]]",
                           "a = [\n  [\n 1],\n[2], # c\n]\n[b]",
                           "a = {b = [\n]}",
                           "a = {}",
                           "a = { b.c = 1, 'd' = {} }",
                           "a=\"x\"",
                           "a = ['x','y']",
                           "a.'b'.\"c\" = {'d'='e'}",
                           "\"a\" = 1",
                           "1 = 2",
                           "-a_ = true",
                           "a = -1_000.5e-3",
                           "a = [+1, 0.25, 2E9, -inf, nan, false]",
                           "a = '''x'''''",
                           "a = \"\"\"\"\"\"",
                           "a = \"x\\\\\"",
                           "a = \"#\" # [",
                           "a = 1\n\n\t\nb = 2"}) {
    EXPECT_EQ(Error(text), "nothing thrown") << text;
  }
  const std::string deep = "a = " + std::string(32, '[') + std::string(32, ']');
  EXPECT_EQ(Error(deep), "nothing thrown");
}

TEST(TomlTextTest, LinesMayEndAsOnWindows) {
  EXPECT_EQ(Error("a = 1\r\nb = [\r\n  1,\r\n]\r\n\r\n[c]\r\n"), "nothing thrown");
  EXPECT_THAT(Error("\na = 1\rb = 2"), testing::StartsWith("run.toml:2: "));
}

TEST(TomlTextTest, UnmatchedBracketsAreRefused) {
  for (const char* text : {"\na = [}", "\na = {]", "\na = [[1]", "\na = {b = 1", "\na = [1}",
                           "\na = {b = 1]", "\n[a", "\n[[a]", "\n[a}", "\na = 1]", "\n]", "\n}",
                           "\n[a]]", "\na = ", "\na", "\na.", "\n[", "\na = [\n1,\n"}) {
    EXPECT_THAT(Error(text), testing::StartsWith("run.toml:2: ")) << text;
  }
  EXPECT_THAT(Error("\na = [\n1,\n[2]\n"),
              testing::StartsWith("run.toml:2: the bracket that opens"));
  EXPECT_THAT(Error("a = " + std::string(33, '[') + std::string(33, ']')),
              testing::HasSubstr("more than 32 deep"));
}

TEST(TomlTextTest, MisplacedValuesAreRefused) {
  for (const char* text : {"\na = \n",
                           "\na = , ",
                           "\na = [,]",
                           "\na = [1,,2]",
                           "\na = [1 2]",
                           "\na = {b}",
                           "\na = {b = }",
                           "\na = {b = 1,}",
                           "\na = {b = 1 c = 2}",
                           "\na = {,}",
                           "\na = {\n}",
                           "\n= 1",
                           "\na b = 1",
                           "\na = 1 2",
                           "\na = 1 b = 2",
                           "\na = true false",
                           "\na = truer",
                           "\na = b",
                           "\na = 1.",
                           "\na = .5",
                           "\na = 1e",
                           "\na = 1__0",
                           "\na = 1_",
                           "\na = - 1",
                           "\na = --1",
                           "\na = 0x10",
                           "\na = 1979-05-27",
                           "\na = 2000-01-01 1,",
                           "\na = 07:32:00",
                           "\n.a = 1",
                           "\na..b = 1",
                           "\n%",
                           "\na = 9\"x\xC3\xA9\"",
                           "\na'b' = 1",
                           "\na = 'b''c'",
                           "\na = 1\r2",
                           "\n'''a''' = 1"}) {
    EXPECT_THAT(Error(text), testing::StartsWith("run.toml:2: ")) << text;
  }
}

TEST(TomlTextTest, TablesNeedANameOnTheirLine) {
  for (const char* text : {"\n[\nk]", "\n  [[ \r\nk]]", "\n[ # k\n]", "#\n[\n\n]", "\n[[[a",
                           "\n[%]", "\n[ [a]]", "\n[]"}) {
    EXPECT_THAT(Error(text), testing::StartsWith("run.toml:2: there must be a name")) << text;
  }
}

TEST(TomlTextTest, OpenQuotesAreRefused) {
  for (const char* text :
       {"\na = 'open", "\na = 'open\nb = '", "\na = \"open\\\"", "\na = \"open\\\n\"",
        "\na = \"\"\"open\"\"", "\na = '''open\n\n", "\na = '", "\n\"a = 1"}) {
    EXPECT_EQ(Error(text), "run.toml:2: the quotes that begin here are not closed") << text;
  }
}

TEST(TomlTextTest, RefusesBinaryInput) {
  EXPECT_EQ(
      Error("a = 1\n\x01"),
      "run.toml:2: there is the control character 1; check that this is a configuration file");
  for (const char* broken : {"# \xC3", "# \x80", "# \xF8\x80", "# \xE0\x80"}) {
    EXPECT_THAT(Error(broken), testing::HasSubstr("not UTF-8")) << broken;
  }
  EXPECT_THAT(Error(std::string((1U << 20U) + 1, '\n')), testing::HasSubstr("mebibyte"));
}

TEST(TomlTextTest, FoldersAndDevicesAreNoConfigurations) {
  const auto error = [](const char* file) {
    return dfr::test::MessageOf<std::runtime_error>([&] { static_cast<void>(ReadTomlText(file)); });
  };
  EXPECT_EQ(error("/proc"), "/proc: is a folder; name a file in it");
  EXPECT_EQ(error("/dev/zero"), "/dev/zero: is a device; name a file");
  EXPECT_EQ(error("/nonexistent.toml"), "/nonexistent.toml: cannot be read");
  EXPECT_NE(ReadTomlText("/proc/version"), "");
}

}  // namespace
}  // namespace dfr::core
