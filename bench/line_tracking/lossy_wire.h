#pragma once

#include <atomic>
#include <cstdint>
#include <string>
#include <thread>

namespace dfr::bench {

/// Two hosts on this machine (Linux network namespaces) and a cable between them that loses and
/// delays packets on command. Each packet is treated independently in both directions, so packets
/// also overtake each other. Traffic of a host to itself does not use the cable.
class LossyWire {
 public:
  /// Moves this process to the near host, which has the address 10.77.0.1. The far host has
  /// 10.77.0.2, and each host has a separate loopback. Must be called before threads are started.
  /// @param seed  seed of losses and delays.
  /// @throws std::runtime_error with the system's reason if namespaces are not permitted.
  explicit LossyWire(std::uint64_t seed);
  ~LossyWire();
  LossyWire(const LossyWire&) = delete;
  LossyWire& operator=(const LossyWire&) = delete;

  /// From now on each packet is lost with probability `loss`, or delayed by up to `jitter_s`,
  /// uniformly distributed.
  void Disturb(double loss, double jitter_s) noexcept;

  /// Moves the calling process to the far host. A child of fork() calls it before exec().
  /// @return false on failure, with the reason in errno.
  [[nodiscard]] bool EnterFarHost() const noexcept;

 private:
  void Carry(std::uint64_t seed);

  int near_tap_ = -1;
  int far_tap_ = -1;
  int far_namespace_ = -1;
  std::atomic<double> loss_ = 0.0;
  std::atomic<double> jitter_s_ = 0.0;
  std::atomic<bool> end_ = false;
  std::thread carrier_;
};

}  // namespace dfr::bench
