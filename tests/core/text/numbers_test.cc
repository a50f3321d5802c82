#include "dfr/core/text/numbers.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <limits>
#include <string>

namespace dfr::core {
namespace {

TEST(NumbersTest, DecimalNumbersAreReadToTheBit) {
  EXPECT_EQ(ParseNumber("0"), 0.0);
  EXPECT_EQ(ParseNumber("-1.5e-3"), -1.5e-3);
  EXPECT_EQ(ParseNumber("+7"), 7.0);
  EXPECT_EQ(ParseNumber(".5"), 0.5);
  EXPECT_EQ(ParseNumber("5."), 5.0);
  EXPECT_EQ(ParseNumber("1E5"), 1e5);
  EXPECT_EQ(ParseNumber("0.1"), 0.1);
  EXPECT_EQ(ParseNumber("1.7976931348623157e308"), std::numeric_limits<double>::max());
  EXPECT_EQ(ParseNumber("4.9406564584124654e-324"), std::numeric_limits<double>::denorm_min());
}

TEST(NumbersTest, UnderflowIsZeroAndOverflowIsRefused) {
  EXPECT_EQ(ParseNumber("1e-400"), 0.0);
  EXPECT_TRUE(std::signbit(ParseNumber("-1e-400").value()));
  EXPECT_EQ(ParseNumber("0." + std::string(400, '0') + "1"), 0.0);
  EXPECT_EQ(ParseNumber("1e-99999999999999999999"), 0.0);
  EXPECT_EQ(ParseNumber("1e400"), std::nullopt);
  EXPECT_EQ(ParseNumber("1e99999999999999999999"), std::nullopt);
  EXPECT_EQ(ParseNumber("0.01e+99999999999999999999"), std::nullopt);
  EXPECT_EQ(ParseNumber("0.01e+400"), std::nullopt);
  EXPECT_EQ(ParseNumber("1" + std::string(309, '0')), std::nullopt);
  // The exponent alone does not determine the range.
  EXPECT_EQ(ParseNumber("1" + std::string(400, '0') + "e-5"), std::nullopt);
  EXPECT_EQ(ParseNumber("0." + std::string(400, '0') + "1e5"), 0.0);
}

TEST(NumbersTest, NothingElseIsANumber) {
  for (const char* text :
       {"",         "-",     "+",  ".",   "e5",  "nan", "-nan", "inf",
        "infinity", "0x10",  "1 ", " 1",  "1,5", "1e",  "--1",  "+-1",
        "-+1",      "1.2.3", "1f", "1e+", "\t1", "NaN", "1_0",  "\xEF\xBB\xBF\x31"}) {
    EXPECT_EQ(ParseNumber(text), std::nullopt) << "'" << text << "'";
  }
}

TEST(NumbersTest, ParsesIntegersWithinTheirRange) {
  EXPECT_EQ(ParseInteger<int>("-12"), -12);
  EXPECT_EQ(ParseInteger<int>("+12"), 12);
  EXPECT_EQ(ParseInteger<int>("010"), 10);  // no octal
  EXPECT_EQ(ParseInteger<std::uint64_t>("18446744073709551615"),
            std::numeric_limits<std::uint64_t>::max());
  EXPECT_EQ(ParseInteger<std::uint64_t>("18446744073709551616"), std::nullopt);
  EXPECT_EQ(ParseInteger<std::uint64_t>("-1"), std::nullopt);
  EXPECT_EQ(ParseInteger<int>("2147483648"), std::nullopt);
  for (const char* text : {"", "+", "-", "+-1", "1.0", "1e3", "0x1", " 1", "1 "}) {
    EXPECT_EQ(ParseInteger<int>(text), std::nullopt) << "'" << text << "'";
  }
}

TEST(NumbersTest, AHeadingDoesNotLookLikeANumber) {
  for (const char* text : {"1", "-1", "+.5", "0x10", "1e-400", "nan", "-INF", "Infinity", "1st"}) {
    EXPECT_TRUE(LooksLikeNumber(text)) << text;
  }
  for (const char* text : {"", "x", "x1", "e5", "-", ".", "name", "info", "'1'"}) {
    EXPECT_FALSE(LooksLikeNumber(text)) << text;
  }
}

}  // namespace
}  // namespace dfr::core
