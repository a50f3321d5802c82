#pragma once

#include <atomic>
#include <cstdint>
#include <string>
#include <thread>

namespace dfr::bench {

/// Two hosts on this machine (Linux network namespaces) and the cable between them, which loses and
/// delays packets when told to: each by itself, in both directions, so that they also overtake each
/// other. What a host says to itself does not go through the cable.
class LossyWire {
 public:
  /// Moves this process to the near host, which has the address 10.77.0.1; the far one has
  /// 10.77.0.2, and both have a loopback of their own. To be called before there are threads.
  /// @param seed  of losses and delays.
  /// @throws std::runtime_error with the system's reason, where namespaces are not allowed.
  explicit LossyWire(std::uint64_t seed);
  ~LossyWire();
  LossyWire(const LossyWire&) = delete;
  LossyWire& operator=(const LossyWire&) = delete;

  /// From now on each packet is lost with probability `loss`, or comes later by up to `jitter_s`,
  /// uniformly.
  void Disturb(double loss, double jitter_s) noexcept;

  /// Moves the calling process to the far host; for a child of fork(), before exec().
  /// @return whether it worked; errno says why not.
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
