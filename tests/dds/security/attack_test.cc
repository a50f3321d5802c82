// Packets that strangers send to Fast DDS remove no participant.
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
void SendToAll(int domain, const Bytes& bytes) {
  const int socket = ::socket(AF_INET, SOCK_DGRAM, 0);
  for (int port = 0; port < 20; ++port) {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<std::uint16_t>(7400 + 250 * domain + port));
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    ::sendto(socket, bytes.data(), bytes.size(), 0, reinterpret_cast<const sockaddr*>(&to),
             sizeof(to));
  }
  ::close(socket);
}

// A stranger announces the departure of the publisher's participant, whose GUID prefix each packet
// contains. SafeSizeTest tests all packets that the filter keeps from Fast DDS.
TEST(AttackTest, AStrangerCannotMakeAParticipantLeave) {
  const int domain = test::OwnDomain();
  Participant one({.domain = domain});
  Participant other({.domain = domain});
  Publisher<Flag> publisher(one, "/attacked", Role::kEmergencyStop);
  Subscriber<Flag> subscriber(other, "/attacked", Role::kEmergencyStop);
  // Sends samples until one arrives.
  const auto talk = [&] {
    Eventually([&] {
      Flag flag;
      return publisher.Write({true}) && subscriber.Take(flag);
    });
  };
  talk();
  const Origin writer = publisher.origin();
  Bytes bytes = Header();
  std::copy_n(writer.begin(), 12, bytes.begin() + 8);
  Bytes parameters = {0x70, 0, 16, 0};
  parameters.insert(parameters.end(), writer.begin(), writer.begin() + 12);
  parameters.insert(parameters.end(), {0, 0, 1, 0xc1, 0x71, 0, 4, 0, 0, 0, 0, 3, 1, 0, 0, 0});
  Add(bytes, {.flags = 2, .parameters = parameters, .payload = 0, .announces = true});
  for (int i = 0; i < 10; ++i) SendToAll(domain, bytes);
  {
    // All packets are read once both participants have discovered a later participant, whose
    // announcement queued behind the packets.
    Participant late({.domain = domain});
    const Publisher<Flag> late_publisher(late, "/attacked", Role::kEmergencyStop);
    const Subscriber<Flag> late_subscriber(late, "/attacked", Role::kEmergencyStop);
    Eventually(
        [&] { return publisher.num_subscribers() == 2 && subscriber.health().publishers == 2; });
  }
  EXPECT_EQ(subscriber.health().found, 2) << "the publisher, and the one that came later";
  talk();
}

}  // namespace
}  // namespace dfr::dds
