#pragma once

#include <netinet/in.h>

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/dds/participant.h"
#include "openssl.h"

/// The emergency stop's second way through the network: datagrams of its own, which share neither
/// parser nor threads with DDS. Each says who sends it, its number, when it was sent, and whether
/// the button is pressed. In a secured network it carries the sender's certificate and a signature
/// by its key; without a valid one it is ignored.
namespace dfr::dds::internal {

/// Who sends: a number drawn at random for each button.
using StopSenderId = std::array<std::uint8_t, 16>;

/// UDP port of a domain: between those that DDS uses there.
[[nodiscard]] std::uint16_t StopPort(int domain) noexcept;

/// A socket, closed with its owner.
class StopSocket {
 public:
  StopSocket();  ///< @throws std::runtime_error if the system has none.
  ~StopSocket();
  StopSocket(const StopSocket&) = delete;
  StopSocket& operator=(const StopSocket&) = delete;
  [[nodiscard]] int get() const noexcept { return socket_; }

 private:
  int socket_;
};

/// Writes the datagrams of one button.
class StopWriter {
 public:
  /// @param security  the participant's folder; empty: unsigned datagrams.
  /// @throws std::runtime_error naming what the system or the security files refuse.
  explicit StopWriter(const std::filesystem::path& security);

  /// The next datagram, which says that it was sent at `wall_ns`.
  [[nodiscard]] std::string Next(bool pressed, std::int64_t wall_ns);

 private:
  StopSenderId id_{};
  std::uint64_t sequence_ = 0;
  Owned<EVP_PKEY> key_;
  std::string certificate_;  // DER; empty without security
};

/// Reads what the StopWriters of all buttons write.
class StopReader {
 public:
  /// @param security  the participant's folder; empty: believes unsigned datagrams alone.
  /// @throws as StopWriter.
  explicit StopReader(const std::filesystem::path& security);

  /// Whether a datagram is good: not malformed, of a valid signature, stamped at most a second from
  /// `wall_ns`, and later than all others of its button. Only then sets `who` and `pressed`.
  bool Read(std::string_view datagram, std::int64_t wall_ns, StopSenderId& who, bool& pressed);

 private:
  struct Known {
    StopSenderId who{};
    std::uint64_t sequence = 0;
    std::int64_t heard_ns = 0;
  };
  [[nodiscard]] bool Signed(std::string_view datagram);
  [[nodiscard]] bool New(const StopSenderId& who, std::uint64_t sequence, std::int64_t wall_ns);

  Owned<X509_STORE> authority_;   // null without security
  std::string last_certificate_;  // whose key is the next
  Owned<EVP_PKEY> last_key_;
  std::array<Known, 16> known_{};
};

/// Sends to all listeners of the domain: on this machine, and unless discovery is loopback on every
/// network that it is on. One object belongs to one thread at a time.
class StopSender {
 public:
  /// @throws std::runtime_error naming what the system or the security files refuse.
  explicit StopSender(const ParticipantOptions& options);

  /// False if no datagram could be sent.
  /// @param wall_ns  now, as the datagram says.
  bool Send(bool pressed, std::int64_t wall_ns) noexcept;

 private:
  StopSocket socket_;
  std::vector<sockaddr_in> listeners_;
  StopWriter writer_;
};

/// Receives what StopSender sends. One object belongs to one thread at a time.
class StopListener {
 public:
  /// @throws as StopSender; also if the port is taken by others.
  explicit StopListener(const ParticipantOptions& options);

  /// Takes the next datagram that StopReader finds good. The others are passed over, at most 16 in
  /// a call. False if there is none.
  bool Take(std::int64_t wall_ns, StopSenderId& who, bool& pressed) noexcept;

 private:
  StopSocket socket_;
  bool loopback_;
  StopReader reader_;
};

}  // namespace dfr::dds::internal
