// Messages that the filter keeps from Fast DDS's parser.
#include "guarded_transport.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <vector>

#include "tests/dds/security/rtps_bytes.h"

namespace dfr::dds {
namespace {

using internal::ParticipantCensus;
using internal::SafeSize;
using test::Add;
using test::Bytes;
using test::Header;
using test::Sample;

bool Passes(const Sample& sample) {
  Bytes alone = Header();
  Add(alone, sample);
  Bytes to_end = Header();
  Add(to_end, sample, true);
  EXPECT_EQ(SafeSize(alone) > 0, SafeSize(to_end) > 0);
  // The next submessage does not belong to the sample.
  Bytes first = Header();
  Add(first, sample);
  Add(first, 0x07, 28);
  EXPECT_EQ(SafeSize(first) > 0, SafeSize(alone) > 0);
  return SafeSize(alone) == alone.size();
}

// A key hash and the end of the list.
const Bytes kParameters = {0x70, 0, 4, 0, 1, 2, 3, 4, 1, 0, 0, 0};

TEST(SafeSizeTest, WholeMessagesPassUnchanged) {
  Bytes bytes = Header();
  Add(bytes, 0x0e, 12);
  Add(bytes, 0x09, 8);
  Add(bytes, {.little = false, .payload = 300});
  EXPECT_EQ(SafeSize(bytes), bytes.size());
  Add(bytes, 0x09, 0);  // INFO_TS without a timestamp
  Add(bytes, 0x07, 28);
  EXPECT_EQ(SafeSize(bytes), bytes.size());
  Add(bytes, {.payload = 100}, true);
  EXPECT_EQ(SafeSize(bytes), bytes.size());
}

TEST(SafeSizeTest, CompleteSamplesPass) {
  EXPECT_TRUE(Passes({}));
  EXPECT_TRUE(Passes({.payload = 1}));
  EXPECT_TRUE(Passes({.to_parameters = 20}));  // fields of later versions before the parameters
  EXPECT_TRUE(Passes({.flags = 4 | 2, .parameters = kParameters}));
  EXPECT_TRUE(Passes({.flags = 8, .payload = 16}));                            // a key
  EXPECT_TRUE(Passes({.flags = 2, .parameters = kParameters, .payload = 0}));  // no data
  EXPECT_TRUE(Passes({.little = false, .fragments = true, .flags = 0}));
  EXPECT_TRUE(Passes({.fragments = true, .flags = 2, .parameters = kParameters}));
  EXPECT_TRUE(Passes({.fragments = true,
                      .flags = 0,
                      .payload = 2000,
                      .first = 4,
                      .count = 2,
                      .size = 1000,
                      .whole = 4001}));
}

TEST(SafeSizeTest, SamplesThatDeclareMoreThanTheyContainAreDropped) {
  EXPECT_FALSE(Passes({.payload = 0}));
  EXPECT_FALSE(Passes({.flags = 4 | 2, .parameters = kParameters, .payload = 0}));
  EXPECT_FALSE(Passes({.flags = 8, .payload = 0}));
  EXPECT_FALSE(Passes({.flags = 4 | 8}));
  for (const std::uint32_t octets : {1U, 15U, 37U, 0x7fffU, 0x8000U, 0xfff0U, 0xffffU}) {
    EXPECT_FALSE(Passes({.to_parameters = octets})) << octets;
  }
  // Parameter lists without an end marker, or with a parameter that is longer than the content.
  const Bytes cut(kParameters.begin(), kParameters.end() - 4);
  EXPECT_FALSE(Passes({.flags = 4 | 2, .parameters = cut, .payload = 3}));
  EXPECT_FALSE(Passes({.flags = 4 | 2, .parameters = {0x70, 0, 0xff, 0xff}}));
  EXPECT_FALSE(Passes({.flags = 4 | 2, .parameters = {0x70, 0, 17, 0}, .payload = 20}));
  const Sample good = {.fragments = true, .flags = 0};
  const auto spoiled = [&good](auto spoil) {
    Sample sample = good;
    spoil(sample);
    return sample;
  };
  EXPECT_TRUE(Passes(good));
  EXPECT_FALSE(Passes(spoiled([](Sample& s) { s.payload = 0; })));
  EXPECT_FALSE(Passes(spoiled([](Sample& s) { s.flags = 4; })));
  EXPECT_FALSE(Passes(spoiled([](Sample& s) { s.first = 0; })));
  EXPECT_FALSE(Passes(spoiled([](Sample& s) { s.first = 2; })));
  EXPECT_FALSE(Passes(spoiled([](Sample& s) { s.count = 0; })));
  EXPECT_FALSE(Passes(spoiled([](Sample& s) { s.count = 2; })));
  EXPECT_FALSE(Passes(spoiled([](Sample& s) { s.size = 0; })));
  EXPECT_FALSE(Passes(spoiled([](Sample& s) { s.size = 19; })));
  EXPECT_FALSE(Passes(spoiled([](Sample& s) { s.whole = 0; })));
}

TEST(SafeSizeTest, StatisticsAndLaterSubmessagesAreCutOff) {
  Bytes bytes = Header();
  Add(bytes, 0x80, 58);
  EXPECT_EQ(bytes.size(), 82U);
  EXPECT_EQ(SafeSize(bytes), 0U) << "nothing is left";
  bytes = Header();
  Add(bytes, 0x07, 28);
  const std::size_t good = bytes.size();
  Add(bytes, 0x80, 56);
  EXPECT_EQ(SafeSize(bytes), good);
  Add(bytes, Sample{});
  EXPECT_EQ(SafeSize(bytes), good);
}

TEST(SafeSizeTest, ParticipantLeavesMessagesAreDropped) {
  const Bytes status = {0x71, 0, 4, 0, 0, 0, 0, 3, 1, 0, 0, 0};
  const Bytes status_big = {0, 0x71, 0, 4, 0, 0, 0, 3, 0, 1, 0, 0};
  EXPECT_TRUE(Passes({.announces = true}));
  EXPECT_TRUE(Passes({.flags = 4 | 2, .parameters = kParameters, .announces = true}));
  EXPECT_TRUE(Passes({.fragments = true, .flags = 0, .announces = true}));
  EXPECT_TRUE(Passes({.flags = 4 | 2, .parameters = status})) << "of something else";
  EXPECT_FALSE(Passes({.flags = 4 | 2, .parameters = status, .announces = true}));
  EXPECT_FALSE(
      Passes({.little = false, .flags = 4 | 2, .parameters = status_big, .announces = true}));
  EXPECT_FALSE(Passes({.flags = 8 | 2, .parameters = status, .announces = true}));
  EXPECT_FALSE(Passes({.flags = 8, .announces = true}));
  EXPECT_FALSE(Passes({.flags = 2, .parameters = kParameters, .payload = 0, .announces = true}));
  EXPECT_FALSE(Passes({.fragments = true, .flags = 2, .parameters = status, .announces = true}));
  Bytes bytes = Header();
  Add(bytes, 0x07, 28);
  const std::size_t good = bytes.size();
  Add(bytes, {.flags = 8, .announces = true});
  Add(bytes, 0x07, 28);
  EXPECT_EQ(SafeSize(bytes), good);
  EXPECT_EQ(SafeSize(bytes, /*may_leave=*/true), bytes.size());
}

TEST(SafeSizeTest, MalformedMessagesAreDropped) {
  EXPECT_EQ(SafeSize({}), 0U);
  EXPECT_EQ(SafeSize(Header()), 0U) << "it has no submessage";
  Bytes bytes = Header();
  Add(bytes, Sample{});
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    EXPECT_EQ(SafeSize({bytes.data(), size}), 0U) << size;
  }
  bytes[0] = 'X';
  EXPECT_EQ(SafeSize(bytes), 0U);
}

TEST(ParticipantCensusTest, ParticipantsHeardBeforeAFloodStayAdmitted) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  const ParticipantCensus::Address here{1};
  const ParticipantCensus::Address there{2};
  const auto number = [](std::uint32_t n) {
    ParticipantCensus::Prefix prefix{};
    for (std::size_t k = 0; k < 4; ++k) prefix[k] = static_cast<std::uint8_t>(n >> (8 * k));
    return prefix;
  };
  ParticipantCensus census;
  std::int64_t now_ns = 100 * kSecond;
  ASSERT_TRUE(census.Admits(here, number(0), now_ns));
  int admitted = 0;
  for (std::uint32_t n = 1; n < 100'000; ++n) {
    now_ns += kSecond / 1000;
    admitted += census.Admits(here, number(n), now_ns);
    ASSERT_TRUE(census.Admits(here, number(0), now_ns));
    ASSERT_TRUE(census.Admits(there, number(0), now_ns));
  }
  // All other participants fall silent at once, and the census forgets them after 20 s. It can
  // therefore fill five times in 100 s.
  EXPECT_LE(admitted, 5 * static_cast<int>(ParticipantCensus::kPerAddress));
  EXPECT_GE(admitted, static_cast<int>(ParticipantCensus::kPerAddress) - 1);
  now_ns += 21 * kSecond;
  EXPECT_TRUE(census.Admits(here, number(7), now_ns)) << "others are admitted after the flood";
}

TEST(ParticipantCensusTest, ManyAddressesNeedNoMoreMemory) {
  ParticipantCensus census;
  std::size_t admitted = 0;
  for (std::uint32_t n = 0; n < 10'000; ++n) {
    ParticipantCensus::Address address{};
    for (std::size_t k = 0; k < 4; ++k) address[k] = static_cast<std::uint8_t>(n >> (8 * k));
    admitted += census.Admits(address, {}, 1'000'000'000) ? 1U : 0U;
  }
  EXPECT_EQ(admitted, ParticipantCensus::kInAll);
}

}  // namespace
}  // namespace dfr::dds
