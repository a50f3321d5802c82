#pragma once

#include <netinet/in.h>

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/dds/participant.h"
#include "security/openssl.h"

/// Second path of the emergency stop through the network: datagrams that share neither parser nor
/// threads with DDS. Each contains the sender's id, a sequence number, the time of sending, and the
/// state of the button. In a secured network it also contains the sender's certificate and
/// signature, and the receiver ignores datagrams without a valid signature.
namespace dfr::dds::internal {

/// Identifies a sender: a random number for each button.
using StopSenderId = std::array<std::uint8_t, 16>;

/// Returns the UDP port of a domain's datagrams. DDS does not use this port.
[[nodiscard]] std::uint16_t StopPort(int domain) noexcept;

/// Non-blocking UDP socket, closed by the destructor.
class StopSocket {
 public:
  StopSocket();  ///< @throws std::runtime_error if the system refuses a socket.
  ~StopSocket();
  StopSocket(const StopSocket&) = delete;
  StopSocket& operator=(const StopSocket&) = delete;
  [[nodiscard]] int get() const noexcept { return socket_; }

 private:
  int socket_;
};

/// Creates the datagrams of one button.
class StopWriter {
 public:
  /// @param security  the participant's folder; empty: unsigned datagrams.
  /// @throws std::runtime_error naming the system's error or the fault of a security file.
  explicit StopWriter(const std::filesystem::path& security);

  /// Returns the next datagram, stamped `wall_ns`.
  [[nodiscard]] std::string Next(bool pressed, std::int64_t wall_ns);

 private:
  StopSenderId id_{};
  std::uint64_t sequence_ = 0;
  Owned<EVP_PKEY> key_;
  std::string certificate_;  // DER; empty without security
};

/// Reads the datagrams of all buttons.
class StopReader {
 public:
  /// @param security  the participant's folder; empty: accepts only unsigned datagrams.
  /// @throws as StopWriter.
  explicit StopReader(const std::filesystem::path& security);

  /// Returns true if a datagram is valid: well formed, with a valid signature, stamped within a
  /// second of `wall_ns`, and numbered higher than its button's last valid datagram. Sets `who` and
  /// `pressed` only if the datagram is valid. With security, `who` depends on the certificate:
  /// nobody can send in the name of another participant.
  bool Read(std::string_view datagram, std::int64_t wall_ns, StopSenderId& who, bool& pressed);
  /// True if the last datagram with a valid signature was refused because of its stamp.
  [[nodiscard]] bool clocks_differ() const noexcept { return clocks_differ_; }

 private:
  struct Known {
    StopSenderId who{};
    std::uint64_t sequence = 0;
    std::int64_t heard_ns = 0;
  };
  [[nodiscard]] bool Signed(std::string_view datagram);
  // Returns the sender of a datagram with a valid signature.
  [[nodiscard]] StopSenderId SenderOf(std::string_view datagram) const;
  [[nodiscard]] bool New(const StopSenderId& who, std::uint64_t sequence, std::int64_t wall_ns);

  Owned<X509_STORE> authority_;   // nullptr without security
  std::string last_certificate_;  // certificate of last_key_
  Owned<EVP_PKEY> last_key_;
  std::array<Known, 16> known_{};
  bool clocks_differ_ = false;
};

/// Sends stop messages to all listeners of the domain on this machine. Unless discovery is
/// kLoopback, also broadcasts them on its networks. One object belongs to one thread at a time.
class StopSender {
 public:
  /// @throws std::runtime_error naming the system's error or the fault of a security file.
  explicit StopSender(const ParticipantOptions& options);

  /// Returns false if no datagram could be sent.
  /// @param wall_ns  current system time, for the datagram's stamp.
  bool Send(bool pressed, std::int64_t wall_ns) noexcept;

 private:
  StopSocket socket_;
  std::vector<sockaddr_in> listeners_;
  StopWriter writer_;
};

/// Receives StopSender's datagrams. One object belongs to one thread at a time.
class StopListener {
 public:
  /// @throws as StopSender; also if another program uses the port.
  explicit StopListener(const ParticipantOptions& options);

  /// Takes datagrams, at most 16 per call, until StopReader accepts one. Returns false if it
  /// accepts none.
  bool Take(std::int64_t wall_ns, StopSenderId& who, bool& pressed) noexcept;
  /// Same as StopReader::clocks_differ().
  [[nodiscard]] bool clocks_differ() const noexcept { return reader_.clocks_differ(); }

 private:
  StopSocket socket_;
  bool loopback_;
  StopReader reader_;
};

}  // namespace dfr::dds::internal
