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

using ParticipantPrefix = std::array<std::uint8_t, 12>;  ///< A participant's, in its GUID.

/// How much of an RTPS message is handed to Fast DDS, bytes: its well-formed beginning, up to the
/// first of Fast DDS's own statistics submessages (0x80), which nobody here reads. 0: nothing. Fast
/// DDS 2.9 parses those before any security, and assertions end the process where one is malformed.
/// Samples (DATA, DATA_FRAG) whose parameters or payload are not within them are malformed, too.
///
/// The word that a participant leaves is cut off with what follows, unless `may_leave`: anyone can
/// say it of anyone, and an assertion ends the process where it comes as that participant's lease
/// is looked at. Who leaves takes back its publishers and subscribers by other words, and is
/// forgotten after its lease.
[[nodiscard]] std::size_t SafeSize(std::span<const std::uint8_t> message,
                                   bool may_leave = false) noexcept;

/// A participant of this process is about to end. The others in the process call it directly, and
/// have to forget it at once: its word that it leaves is handed on, for some seconds.
void Leaves(const ParticipantPrefix& prefix);

/// Counts who sends, so that a flood of invented participants ends here and not in Fast DDS's
/// memory and discovery. Safe to use from several threads.
class ParticipantCensus {
 public:
  using Address = std::array<std::uint8_t, 16>;
  using Prefix = ParticipantPrefix;

  static constexpr std::size_t kPerAddress = 64;    ///< More at one address are not heard.
  static constexpr std::size_t kInAll = 512;        ///< Nor more at all addresses together.
  static constexpr std::int64_t kForgotten_s = 20;  ///< One that was silent for so long has left.

  /// Whether `prefix` at `address` is heard: one that was heard before stays so.
  /// @param steady_ns  a clock that never goes back.
  [[nodiscard]] bool Admits(const Address& address, const Prefix& prefix, std::int64_t steady_ns);

 private:
  void Forget(std::int64_t steady_ns);

  std::mutex mutex_;
  std::map<std::pair<Address, Prefix>, std::int64_t> heard_ns_;
  std::map<Address, std::size_t> count_;
  std::int64_t swept_ns_ = 0;
};

/// A transport around another one, which hands on what SafeSize() and ParticipantCensus allow of
/// what it receives.
[[nodiscard]] std::shared_ptr<eprosima::fastdds::rtps::TransportDescriptorInterface> Guarded(
    std::shared_ptr<eprosima::fastdds::rtps::TransportDescriptorInterface> transport);

}  // namespace dfr::dds::internal
