#include "packet_storm.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <stdexcept>

#include "dfr/core/random.h"

namespace dfr::bench {
namespace {

using Bytes = std::vector<std::uint8_t>;

constexpr int kParticipants = 12;  // maximum number of targeted participants of a domain
constexpr std::size_t kMostKept = 64;

sockaddr_in Address(std::uint32_t host, int port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(host);
  return address;
}

bool Bind(int socket, std::uint32_t host, int port) {
  const sockaddr_in address = Address(host, port);
  return bind(socket, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
}

class Writer {
 public:
  explicit Writer(std::uint64_t seed) : random_(seed) {}

  /// Creates a packet for DDS from one of the messages `heard`, or from scratch.
  Bytes Message(const std::vector<Bytes>& heard) {
    const std::uint64_t kind = Below(10);
    if (kind == 0) return Noise(Below(300));
    if (kind < 5 || heard.empty()) return Submessages(heard);
    return Changed(heard[Below(heard.size())], kind < 8);
  }
  /// Creates a datagram of an emergency stop that every receiver must reject.
  Bytes Stop(const std::vector<Bytes>& heard) {
    if (heard.empty() || Below(4) == 0) return Noise(Below(120));
    Bytes bytes = Changed(heard[Below(heard.size())], false);
    // Sets a time in the far future. Otherwise some datagrams would be valid messages of another
    // button, or later messages of this button. Without security a robot accepts such messages from
    // anyone, and holds.
    if (bytes.size() > 32) bytes[32] = 255;
    return bytes;
  }
  std::uint64_t Below(std::uint64_t end) { return random_.Below(end); }

 private:
  std::uint8_t Byte() { return static_cast<std::uint8_t>(Below(256)); }
  Bytes Noise(std::size_t size) {
    Bytes bytes(size);
    for (std::uint8_t& byte : bytes) byte = Byte();
    return bytes;
  }
  void Prefix(Bytes& bytes, const std::vector<Bytes>& heard) {
    // The sender is one of sixteen strangers, or occasionally a known sender.
    const bool known = !heard.empty() && Below(20) == 0;
    const Bytes* from = known ? &heard[Below(heard.size())] : nullptr;
    const auto stranger = static_cast<std::uint8_t>(1 + Below(16));
    for (std::size_t k = 8; k < 20; ++k) {
      bytes[k] = from != nullptr && from->size() > k ? (*from)[k] : stranger;
    }
  }
  Bytes Submessages(const std::vector<Bytes>& heard) {
    constexpr std::array<std::uint8_t, 21> kKinds = {0x01, 0x06, 0x07, 0x08, 0x09, 0x0c, 0x0d,
                                                     0x0e, 0x0f, 0x12, 0x13, 0x15, 0x15, 0x15,
                                                     0x16, 0x30, 0x31, 0x32, 0x33, 0x34, 0x80};
    // Entity ids of discovery, liveliness and security.
    constexpr std::array<std::array<std::uint8_t, 4>, 12> kEnds = {{{0, 0, 0, 0},
                                                                    {0, 0, 1, 0xc1},
                                                                    {0, 1, 0, 0xc2},
                                                                    {0, 1, 0, 0xc7},
                                                                    {0, 0, 3, 0xc2},
                                                                    {0, 0, 3, 0xc7},
                                                                    {0, 0, 4, 0xc2},
                                                                    {0, 0, 4, 0xc7},
                                                                    {0, 2, 0, 0xc2},
                                                                    {0, 2, 0, 0xc7},
                                                                    {0, 2, 1, 0xc3},
                                                                    {0, 0, 1, 0x04}}};
    Bytes bytes = {'R', 'T', 'P', 'S', 2, 3, 1, 15};
    bytes.resize(20);
    Prefix(bytes, heard);
    const std::uint64_t count = 1 + Below(4);
    for (std::uint64_t n = 0; n < count; ++n) {
      const std::uint8_t kind = kKinds[Below(kKinds.size())];
      const std::uint8_t flags = Below(4) == 0 ? Byte() : static_cast<std::uint8_t>(1 | Below(16));
      Bytes content = Noise(Below(5) == 0 ? Below(200) : 4 * Below(24));
      // Small numbers are valid values of fields more often than large numbers.
      for (std::uint8_t& byte : content) byte = Below(3) == 0 ? byte : byte & 3U;
      const bool data = kind == 0x15 || kind == 0x16;
      for (const std::size_t at : {std::size_t{data ? 4U : 0U}, std::size_t{data ? 8U : 4U}}) {
        if (content.size() < at + 4) continue;
        const auto& end = kEnds[Below(kEnds.size())];
        std::copy(end.begin(), end.end(), content.begin() + static_cast<std::ptrdiff_t>(at));
      }
      std::size_t length = content.size();
      if (Below(10) == 0) length = Below(70'000);
      bytes.insert(bytes.end(), {kind, flags, static_cast<std::uint8_t>(length & 255U),
                                 static_cast<std::uint8_t>((length >> 8U) & 255U)});
      bytes.insert(bytes.end(), content.begin(), content.end());
    }
    return bytes;
  }
  Bytes Changed(Bytes bytes, bool of_stranger) {
    if (of_stranger && bytes.size() >= 20) Prefix(bytes, {});
    const std::uint64_t changes = 1 + Below(8);
    for (std::uint64_t n = 0; n < changes && bytes.size() > 20; ++n) {
      // The header stays valid, because receivers ignore messages with an invalid header.
      std::uint8_t& byte = bytes[20 + Below(bytes.size() - 20)];
      const std::uint64_t how = Below(4);
      byte = how == 0   ? Byte()
             : how == 1 ? static_cast<std::uint8_t>(byte ^ (1U << Below(8)))
             : how == 2 ? 0
                        : 255;
    }
    if (Below(6) == 0) bytes.resize(Below(bytes.size() + 1));
    if (Below(6) == 0) {
      const Bytes more = Noise(Below(60));
      bytes.insert(bytes.end(), more.begin(), more.end());
    }
    return bytes;
  }

  core::Random random_;
};

}  // namespace

PacketStorm::PacketStorm(int domain, double rate, std::uint64_t seed) : domain_(domain) {
  const int yes = 1;
  out_ = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  announcements_ = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  stops_ = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  bool bound = out_ >= 0 && setsockopt(out_, SOL_SOCKET, SO_BROADCAST, &yes, sizeof yes) == 0 &&
               setsockopt(stops_, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes) == 0 &&
               Bind(stops_, INADDR_ANY, 7405 + 250 * domain);
  bool free_port = false;
  for (int n = 0; bound && !free_port && n < kParticipants; ++n) {
    free_port = Bind(announcements_, INADDR_LOOPBACK, 7410 + 250 * domain + 2 * n);
  }
  if (!bound || !free_port) {
    for (const int s : {out_, announcements_, stops_}) {
      if (s >= 0) close(s);
    }
    throw std::runtime_error("cannot listen on any port of domain " + std::to_string(domain));
  }
  thread_ = std::thread([this, rate, seed] { Run(rate, seed); });
}

PacketStorm::~PacketStorm() {
  end_ = true;
  thread_.join();
  for (const int s : {out_, announcements_, stops_}) close(s);
}

void PacketStorm::Run(double rate, std::uint64_t seed) {
  Writer writer(seed);
  std::vector<Bytes> announced;
  std::vector<Bytes> stops;
  std::vector<int> ports = {7400 + 250 * domain_, 7401 + 250 * domain_};
  for (int n = 0; n < 2 * kParticipants; ++n) ports.push_back(7410 + 250 * domain_ + n);
  const auto keep = [&](int from, std::vector<Bytes>& kept) {
    std::array<std::uint8_t, 4096> buffer;
    for (ssize_t size = 0; (size = recv(from, buffer.data(), buffer.size(), 0)) > 0;) {
      ++heard_;
      Bytes bytes(buffer.begin(), buffer.begin() + size);
      if (kept.size() < kMostKept) {
        kept.push_back(std::move(bytes));
      } else {
        kept[writer.Below(kMostKept)] = std::move(bytes);
      }
    }
  };
  using Clock = std::chrono::steady_clock;
  constexpr double kPause_s = 0.002;
  const auto burst = static_cast<int>(std::lround(rate * kPause_s));
  for (auto next = Clock::now(); !end_; std::this_thread::sleep_until(next)) {
    next = std::max(next, Clock::now() - std::chrono::milliseconds(20)) +
           std::chrono::microseconds(std::lround(1e6 * kPause_s));
    keep(announcements_, announced);
    // The storm's own packets also arrive here. They are discarded, because no stop sent them.
    std::vector<Bytes> said;
    keep(stops_, said);
    for (Bytes& bytes : said) {
      if (bytes.size() < 43 || bytes[0] != 'd' || bytes[40] != 0) continue;
      if (stops.size() == kMostKept) stops.erase(stops.begin());
      stops.push_back(std::move(bytes));
    }
    for (int n = 0; n < burst && blows_; ++n) {
      const bool stop = writer.Below(10) == 0;
      const Bytes packet = stop ? writer.Stop(stops) : writer.Message(announced);
      const sockaddr_in to = stop ? Address(0x7fffffff, 7405 + 250 * domain_)
                                  : Address(INADDR_LOOPBACK, ports[writer.Below(ports.size())]);
      static_cast<void>(sendto(out_, packet.data(), packet.size(), MSG_NOSIGNAL,
                               reinterpret_cast<const sockaddr*>(&to), sizeof to));
      ++sent_;
    }
  }
}

}  // namespace dfr::bench
