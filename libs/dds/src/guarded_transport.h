#pragma once

#include <fastdds/rtps/transport/TransportDescriptorInterface.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <utility>

namespace dfr::dds::internal {

using ParticipantPrefix = std::array<std::uint8_t, 12>;  ///< Prefix of a participant's GUID.

/// Returns the number of leading bytes of an RTPS message that are safe to pass to Fast DDS: 0 if
/// the message is malformed, otherwise the bytes before the first statistics submessage (0x80), a
/// kind that dfr does not use. Fast DDS 2.9 parses this kind before any security check, and an
/// assertion ends the process if the submessage is malformed. A sample (DATA, DATA_FRAG) is
/// malformed if its parameters or payload extend beyond its submessage.
///
/// Unless `may_leave`, the bytes also end before the first announcement that a participant leaves.
/// Any sender can forge this announcement, and an assertion ends the process if it arrives while
/// that participant's lease is checked. A departing participant removes its publishers and
/// subscribers by other messages, and expires after its lease.
[[nodiscard]] std::size_t SafeSize(std::span<const std::uint8_t> message,
                                   bool may_leave = false) noexcept;

/// Reports that a participant of this process is about to end. For several seconds, its departure
/// message is passed to the other participants in the process, which drop it at once.
void Leaves(const ParticipantPrefix& prefix);

/// Limits the number of senders to protect Fast DDS's memory and discovery from a flood of forged
/// participants. Thread-safe.
class ParticipantCensus {
 public:
  using Address = std::array<std::uint8_t, 16>;
  using Prefix = ParticipantPrefix;

  static constexpr std::size_t kPerAddress = 64;    ///< Maximum number of senders at one address.
  static constexpr std::size_t kInAll = 512;        ///< Maximum number of senders in total.
  static constexpr std::int64_t kForgotten_s = 20;  ///< Maximum silence of an accepted sender.

  /// Returns true if messages from the participant `prefix` at `address` are accepted. An accepted
  /// sender stays accepted until it is silent for more than kForgotten_s.
  /// @param steady_ns  time of a monotonic clock.
  [[nodiscard]] bool Admits(const Address& address, const Prefix& prefix, std::int64_t steady_ns);

 private:
  void Forget(std::int64_t steady_ns);

  std::mutex mutex_;
  std::map<std::pair<Address, Prefix>, std::int64_t> heard_ns_;
  std::map<Address, std::size_t> count_;
  std::int64_t swept_ns_ = 0;
};

/// Wraps a transport to drop received data that SafeSize() or ParticipantCensus excludes.
[[nodiscard]] std::shared_ptr<eprosima::fastdds::rtps::TransportDescriptorInterface> Guarded(
    std::shared_ptr<eprosima::fastdds::rtps::TransportDescriptorInterface> transport);

}  // namespace dfr::dds::internal
