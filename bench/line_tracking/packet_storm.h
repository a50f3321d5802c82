#pragma once

#include <atomic>
#include <cstdint>
#include <thread>
#include <vector>

namespace dfr::bench {

/// Sends packets to every UDP port of this machine at which a program of a DDS domain may listen,
/// including the emergency stop's: random bytes, RTPS messages of random submessages, and the
/// programs' own messages with bytes changed, removed or added. The storm has no key. It reads the
/// programs' messages at a free port that receives announcements. A separate thread runs from
/// construction to destruction.
class PacketStorm {
 public:
  /// @param rate  packets per second.
  /// @throws std::runtime_error if the system refuses a socket, or no port is free.
  PacketStorm(int domain, double rate, std::uint64_t seed);
  ~PacketStorm();
  PacketStorm(const PacketStorm&) = delete;
  PacketStorm& operator=(const PacketStorm&) = delete;

  /// Starts or stops sending. While stopped, the storm only reads.
  void Blow(bool blows) noexcept { blows_ = blows; }
  [[nodiscard]] std::uint64_t sent() const noexcept { return sent_; }
  /// Returns the number of messages of other programs that it has read and may change.
  [[nodiscard]] std::uint64_t heard() const noexcept { return heard_; }

 private:
  using Bytes = std::vector<std::uint8_t>;
  void Run(double rate, std::uint64_t seed);

  int domain_;
  int out_ = -1;
  int announcements_ = -1;
  int stops_ = -1;
  std::atomic<bool> blows_ = false;
  std::atomic<bool> end_ = false;
  std::atomic<std::uint64_t> sent_ = 0;
  std::atomic<std::uint64_t> heard_ = 0;
  std::thread thread_;
};

}  // namespace dfr::bench
