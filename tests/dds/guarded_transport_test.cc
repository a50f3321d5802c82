// What is kept from Fast DDS's parser, and that nobody is missing because of it.
#include "guarded_transport.h"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <cstdint>
#include <thread>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/dds/channel.h"
#include "tests/dds/domain.h"

namespace dfr::dds {
namespace {

using internal::ParticipantCensus;
using internal::SafeSize;
using Bytes = std::vector<std::uint8_t>;

Bytes Header(std::uint8_t who = 1) {
  Bytes bytes = {'R', 'T', 'P', 'S', 2, 3, 1, 15};
  bytes.insert(bytes.end(), 12, who);
  return bytes;
}

// A submessage with `length` bytes of content, little-endian unless told.
void Add(Bytes& bytes, std::uint8_t kind, std::uint16_t length, bool little = true) {
  const auto low = static_cast<std::uint8_t>(length & 255U);
  const auto high = static_cast<std::uint8_t>(length >> 8U);
  bytes.insert(bytes.end(),
               {kind, static_cast<std::uint8_t>(little), little ? low : high, little ? high : low});
  bytes.insert(bytes.end(), length, 0);
}

void AddNumber(Bytes& bytes, std::uint32_t number, int size, bool little) {
  for (int k = 0; k < size; ++k) {
    bytes.push_back(static_cast<std::uint8_t>(
        number >> (8U * static_cast<unsigned>(little ? k : size - 1 - k))));
  }
}

// What a sample says of itself, and what there is of it.
struct Sample {
  bool little = true;
  bool fragments = false;
  std::uint8_t flags = 4;           // data; key where it is in fragments
  std::uint32_t to_parameters = 0;  // 0: as it should be
  Bytes parameters = {};
  std::size_t payload = 20;
  std::uint32_t first = 1;
  std::uint32_t count = 1;
  std::uint32_t size = 1000;
  std::uint32_t whole = 20;
  bool announces = false;  // that a participant is there
};

// As a submessage; `length` 0: its own, `to_end`: none.
void Add(Bytes& bytes, const Sample& sample, bool to_end = false) {
  Bytes content = {0, 0};
  const std::uint32_t right = sample.fragments ? 28 : 16;
  AddNumber(content, sample.to_parameters == 0 ? right : sample.to_parameters, 2, sample.little);
  const Bytes writer = sample.announces ? Bytes{0, 1, 0, 0xc2} : Bytes{0, 0, 3, 0xc2};
  content.insert(content.end(), 4, 0);  // any reader
  content.insert(content.end(), writer.begin(), writer.end());
  content.insert(content.end(), 4, 0);
  AddNumber(content, 7, 4, sample.little);
  if (sample.fragments) {
    AddNumber(content, sample.first, 4, sample.little);
    AddNumber(content, sample.count, 2, sample.little);
    AddNumber(content, sample.size, 2, sample.little);
    AddNumber(content, sample.whole, 4, sample.little);
  }
  content.insert(content.end(), sample.parameters.begin(), sample.parameters.end());
  content.insert(content.end(), sample.payload, 7);
  const auto endian = static_cast<std::uint8_t>(sample.little);
  bytes.push_back(sample.fragments ? 0x16 : 0x15);
  bytes.push_back(sample.flags | endian);
  AddNumber(bytes, to_end ? 0 : static_cast<std::uint32_t>(content.size()), 2, sample.little);
  bytes.insert(bytes.end(), content.begin(), content.end());
}

bool Passes(const Sample& sample) {
  Bytes alone = Header();
  Add(alone, sample);
  Bytes to_end = Header();
  Add(to_end, sample, true);
  EXPECT_EQ(SafeSize(alone) > 0, SafeSize(to_end) > 0);
  // What comes behind is not a sample's own.
  Bytes first = Header();
  Add(first, sample);
  Add(first, 0x07, 28);
  EXPECT_EQ(SafeSize(first) > 0, SafeSize(alone) > 0);
  return SafeSize(alone) == alone.size();
}

// A key hash, the end of the list.
const Bytes kParameters = {0x70, 0, 4, 0, 1, 2, 3, 4, 1, 0, 0, 0};

TEST(SafeSizeTest, WholeMessagesPassUnchanged) {
  Bytes bytes = Header();
  Add(bytes, 0x0e, 12);
  Add(bytes, 0x09, 8);
  Add(bytes, {.little = false, .payload = 300});
  EXPECT_EQ(SafeSize(bytes), bytes.size());
  Add(bytes, 0x09, 0);  // INFO_TS without a time
  Add(bytes, 0x07, 28);
  EXPECT_EQ(SafeSize(bytes), bytes.size());
  Add(bytes, {.payload = 100}, true);
  EXPECT_EQ(SafeSize(bytes), bytes.size());
}

TEST(SafeSizeTest, SamplesPassWhoseParametersAndPayloadAreThere) {
  EXPECT_TRUE(Passes({}));
  EXPECT_TRUE(Passes({.payload = 1}));
  EXPECT_TRUE(Passes({.to_parameters = 20}));  // parts of later versions before the parameters
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

TEST(SafeSizeTest, SamplesThatClaimMoreThanThereIsAreDropped) {
  EXPECT_FALSE(Passes({.payload = 0}));
  EXPECT_FALSE(Passes({.flags = 4 | 2, .parameters = kParameters, .payload = 0}));
  EXPECT_FALSE(Passes({.flags = 8, .payload = 0}));
  EXPECT_FALSE(Passes({.flags = 4 | 8}));
  for (const std::uint32_t octets : {1U, 15U, 37U, 0x7fffU, 0x8000U, 0xfff0U, 0xffffU}) {
    EXPECT_FALSE(Passes({.to_parameters = octets})) << octets;
  }
  // Parameters without an end, or that go on behind it.
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

TEST(SafeSizeTest, StatisticsAndWhatFollowsThemAreCutOff) {
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

TEST(SafeSizeTest, ThatAParticipantLeavesIsCutOff) {
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
  EXPECT_EQ(SafeSize(Header()), 0U) << "it says nothing";
  Bytes bytes = Header();
  Add(bytes, Sample{});
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    EXPECT_EQ(SafeSize({bytes.data(), size}), 0U) << size;
  }
  bytes[0] = 'X';
  EXPECT_EQ(SafeSize(bytes), 0U);
}

TEST(SafeSizeTest, NeverReadsOrPassesMoreThanThereIs) {
  core::Random random(5);
  for (int i = 0; i < 200'000; ++i) {
    Bytes bytes = Header();
    bytes.resize(static_cast<std::size_t>(random.Uniform(0.0, 120.0)));
    for (std::size_t k = 20; k < bytes.size(); ++k) {
      bytes[k] = static_cast<std::uint8_t>(random.Uniform(0.0, k % 4 == 3 ? 3.0 : 256.0));
    }
    const Bytes exact(bytes);  // on the heap, of this size: a sanitizer sees what lies beyond
    const std::size_t size = SafeSize(exact);
    EXPECT_LE(size, exact.size());
  }
}

TEST(ParticipantCensusTest, ThoseThatWereHeardBeforeAFloodAreHeardThroughout) {
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
  // Each of the others is silent at once, and forgotten after 20 s: five times in 100 s.
  EXPECT_LE(admitted, 5 * static_cast<int>(ParticipantCensus::kPerAddress));
  EXPECT_GE(admitted, static_cast<int>(ParticipantCensus::kPerAddress) - 1);
  now_ns += 21 * kSecond;
  EXPECT_TRUE(census.Admits(here, number(7), now_ns)) << "when it is over, others are heard";
}

TEST(ParticipantCensusTest, ManyAddressesTakeNoMoreMemory) {
  ParticipantCensus census;
  std::size_t admitted = 0;
  for (std::uint32_t n = 0; n < 10'000; ++n) {
    ParticipantCensus::Address address{};
    for (std::size_t k = 0; k < 4; ++k) address[k] = static_cast<std::uint8_t>(n >> (8 * k));
    admitted += census.Admits(address, {}, 1'000'000'000) ? 1U : 0U;
  }
  EXPECT_EQ(admitted, ParticipantCensus::kInAll);
}

// -- against Fast DDS itself ----------------------------------------------------------------------

// To all ports of this machine at which participants of a domain listen.
class Attacker {
 public:
  explicit Attacker(int domain) : domain_(domain), socket_(::socket(AF_INET, SOCK_DGRAM, 0)) {}
  ~Attacker() { ::close(socket_); }
  Attacker(const Attacker&) = delete;
  Attacker& operator=(const Attacker&) = delete;

  void Send(const Bytes& bytes) const {
    for (int port = 0; port < 20; ++port) {
      sockaddr_in to{};
      to.sin_family = AF_INET;
      to.sin_port = htons(static_cast<std::uint16_t>(7400 + 250 * domain_ + port));
      to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
      ::sendto(socket_, bytes.data(), bytes.size(), 0, reinterpret_cast<const sockaddr*>(&to),
               sizeof(to));
    }
  }

 private:
  int domain_;
  int socket_;
};

class AttackTest : public testing::Test {
 protected:
  // Whether a sample gets through, in a minute at most.
  bool Talk() {
    for (int i = 0; i < 12'000; ++i) {
      publisher_.Write({true});
      Flag flag;
      if (subscriber_.Take(flag)) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    return false;
  }

  int domain_ = test::OwnDomain();
  Attacker attacker_{domain_};
  Participant one_{{.domain = domain_}};
  Participant other_{{.domain = domain_}};
  Publisher<Flag> publisher_{one_, "/attacked", Role::kEmergencyStop};
  Subscriber<Flag> subscriber_{other_, "/attacked", Role::kEmergencyStop};
};

// 82 bytes, without any certificate: an assertion of Fast DDS 2.9.1 ended the process.
TEST_F(AttackTest, AMalformedStatisticsMessageEndsNobody) {
  ASSERT_TRUE(Talk());
  for (const std::uint16_t length : {58, 56, 57, 0, 1, 200, 65535}) {
    Bytes bytes = Header(0xab);
    bytes.insert(bytes.end(), {0x80, 0, static_cast<std::uint8_t>(length >> 8U),
                               static_cast<std::uint8_t>(length & 255U)});
    bytes.insert(bytes.end(), 58, 0xff);
    attacker_.Send(bytes);
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  EXPECT_TRUE(Talk());
}

// The same of a sample with parameters and without the payload that its flags announce: Fast DDS
// 2.9.1 freed what was not its own.
TEST_F(AttackTest, NorDoesASampleWithoutItsPayload) {
  ASSERT_TRUE(Talk());
  for (const bool fragments : {false, true}) {
    Bytes bytes = Header(0xab);
    const std::uint8_t data = fragments ? 0 : 4;
    Add(bytes, {.fragments = fragments,
                .flags = static_cast<std::uint8_t>(data | 2U),
                .parameters = {1, 0, 0, 0},
                .payload = 0,
                .announces = true});
    attacker_.Send(bytes);
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  EXPECT_TRUE(Talk());
}

// The publisher's participant leaves, says a stranger; its name is in each of its packets.
TEST_F(AttackTest, NobodyIsForgottenBecauseAStrangerSaysThatItLeaves) {
  ASSERT_TRUE(Talk());
  const Origin writer = publisher_.origin();
  Bytes bytes = Header();
  std::copy_n(writer.begin(), 12, bytes.begin() + 8);
  Bytes parameters = {0x70, 0, 16, 0};
  parameters.insert(parameters.end(), writer.begin(), writer.begin() + 12);
  parameters.insert(parameters.end(), {0, 0, 1, 0xc1, 0x71, 0, 4, 0, 0, 0, 0, 3, 1, 0, 0, 0});
  Add(bytes, {.flags = 2, .parameters = parameters, .payload = 0, .announces = true});
  for (int i = 0; i < 100; ++i) {
    attacker_.Send(bytes);
    ASSERT_EQ(subscriber_.health().publishers, 1) << i;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
}

TEST_F(AttackTest, NeitherDoesGarbageThatLooksLikeMessages) {
  ASSERT_TRUE(Talk());
  core::Random random(11);
  constexpr std::array<std::uint8_t, 18> kKinds = {0x01, 0x06, 0x07, 0x08, 0x09, 0x0c,
                                                   0x0d, 0x0e, 0x0f, 0x12, 0x13, 0x15,
                                                   0x16, 0x30, 0x31, 0x33, 0x34, 0x80};
  for (int i = 0; i < 3000; ++i) {
    Bytes bytes = Header(static_cast<std::uint8_t>(i % 8));
    const int parts = 1 + static_cast<int>(random.Uniform(0.0, 4.0));
    for (int part = 0; part < parts; ++part) {
      const std::size_t begin = bytes.size();
      const auto kind = static_cast<std::size_t>(random.Uniform(0.0, 18.0));
      Add(bytes, kKinds[kind], static_cast<std::uint16_t>(random.Uniform(0.0, 80.0)));
      bytes[begin + 1] = static_cast<std::uint8_t>(random.Uniform(0.0, 16.0)) | 1U;
      for (std::size_t k = begin + 4; k < bytes.size(); ++k) {
        bytes[k] = static_cast<std::uint8_t>(random.Uniform(0.0, 256.0));
      }
    }
    attacker_.Send(bytes);
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  EXPECT_TRUE(Talk());
}

}  // namespace
}  // namespace dfr::dds
