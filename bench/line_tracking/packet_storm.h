#pragma once

#include <atomic>
#include <cstdint>
#include <thread>
#include <vector>

namespace dfr::bench {

/// Sends packets to every UDP port of this machine that a program of a DDS domain may listen at,
/// the emergency stop's included: random bytes, RTPS messages of random submessages, and what the
/// programs themselves announce and say, with bytes changed, cut off or added. It has no key, and
/// reads what it changes at a free port that announcements go to. A thread of its own, from
/// construction to destruction.
class PacketStorm {
 public:
  /// @param rate  packets a second.
  /// @throws std::runtime_error if the system refuses a socket, or no port is free.
  PacketStorm(int domain, double rate, std::uint64_t seed);
  ~PacketStorm();
  PacketStorm(const PacketStorm&) = delete;
  PacketStorm& operator=(const PacketStorm&) = delete;

  /// While false, it only listens.
  void Blow(bool blows) noexcept { blows_ = blows; }
  [[nodiscard]] std::uint64_t sent() const noexcept { return sent_; }
  /// Messages of others that it has read and may change.
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
