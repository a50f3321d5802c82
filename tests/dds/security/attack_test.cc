// Packets that strangers send to Fast DDS remove no participant and end no process.
#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>

#include "dfr/dds/channel.h"
#include "tests/dds/domain.h"
#include "tests/dds/security/rtps_bytes.h"
#include "tests/support/eventually.h"

namespace dfr::dds {
namespace {

using test::Add;
using test::Bytes;
using test::Eventually;
using test::Header;

// Sends to all ports of this machine on which participants of a domain listen.
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
  // Repeats a sample until one arrives.
  void Talk() {
    Eventually([&] {
      Flag flag;
      return publisher_.Write({true}) && subscriber_.Take(flag);
    });
  }
  // Waits until all packets are read: both participants have discovered a later one, whose
  // announcement queued behind them.
  void Digest() {
    Participant late({.domain = domain_});
    const Publisher<Flag> publisher(late, "/attacked", Role::kEmergencyStop);
    const Subscriber<Flag> subscriber(late, "/attacked", Role::kEmergencyStop);
    Eventually(
        [&] { return publisher_.num_subscribers() == 2 && subscriber_.health().publishers == 2; });
  }

  int domain_ = test::OwnDomain();
  Attacker attacker_{domain_};
  Participant one_{{.domain = domain_}};
  Participant other_{{.domain = domain_}};
  Publisher<Flag> publisher_{one_, "/attacked", Role::kEmergencyStop};
  Subscriber<Flag> subscriber_{other_, "/attacked", Role::kEmergencyStop};
};

// The message has 82 bytes and no certificate. An assertion of Fast DDS 2.9.1 ended the process.
TEST_F(AttackTest, AMalformedStatisticsMessageEndsNoProcess) {
  Talk();
  for (const std::uint16_t length : {58, 56, 57, 0, 1, 200, 65535}) {
    Bytes bytes = Header(0xab);
    bytes.insert(bytes.end(), {0x80, 0, static_cast<std::uint8_t>(length >> 8U),
                               static_cast<std::uint8_t>(length & 255U)});
    bytes.insert(bytes.end(), 58, 0xff);
    attacker_.Send(bytes);
  }
  Digest();
  Talk();
}

// The sample has parameters but lacks the payload that its flags declare. Fast DDS 2.9.1 freed
// foreign memory.
TEST_F(AttackTest, ASampleWithoutItsPayloadEndsNoProcess) {
  Talk();
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
  Digest();
  Talk();
}

// A stranger announces the departure of the publisher's participant, whose name each packet
// contains.
TEST_F(AttackTest, AStrangerCannotMakeAParticipantLeave) {
  Talk();
  const Origin writer = publisher_.origin();
  Bytes bytes = Header();
  std::copy_n(writer.begin(), 12, bytes.begin() + 8);
  Bytes parameters = {0x70, 0, 16, 0};
  parameters.insert(parameters.end(), writer.begin(), writer.begin() + 12);
  parameters.insert(parameters.end(), {0, 0, 1, 0xc1, 0x71, 0, 4, 0, 0, 0, 0, 3, 1, 0, 0, 0});
  Add(bytes, {.flags = 2, .parameters = parameters, .payload = 0, .announces = true});
  for (int i = 0; i < 10; ++i) attacker_.Send(bytes);
  Digest();
  EXPECT_EQ(subscriber_.health().found, 2) << "the publisher, and the one that came later";
  Talk();
}

}  // namespace
}  // namespace dfr::dds
