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

TEST(SafeSizeTest, WholeMessagesPassUnchanged) {
  Bytes bytes = Header();
  Add(bytes, 0x0e, 12);
  Add(bytes, 0x09, 8);
  Add(bytes, 0x15, 300, false);
  EXPECT_EQ(SafeSize(bytes), bytes.size());
  Add(bytes, 0x09, 0);  // INFO_TS without a time
  Add(bytes, 0x07, 28);
  EXPECT_EQ(SafeSize(bytes), bytes.size());
  Add(bytes, 0x15, 0);  // to the end
  bytes.insert(bytes.end(), 100, 7);
  EXPECT_EQ(SafeSize(bytes), bytes.size());
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
  Add(bytes, 0x15, 20);
  EXPECT_EQ(SafeSize(bytes), good);
}

TEST(SafeSizeTest, MalformedMessagesAreDropped) {
  EXPECT_EQ(SafeSize({}), 0U);
  EXPECT_EQ(SafeSize(Header()), 0U) << "it says nothing";
  Bytes bytes = Header();
  Add(bytes, 0x15, 40);
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
