#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace dfr::dds {

/// How processes find each other.
enum class Discovery {
  kLoopback,      ///< Processes of this machine alone, also where the loopback has no multicast.
  kNetwork,       ///< Everyone on the local network, by multicast, as ROS 2 does.
  kServerClient,  ///< Through a discovery server, where multicast is not allowed.
  kServer,        ///< Being that server.
};

/// Options for Participant.
struct ParticipantOptions {
  int domain = 0;            ///< As ROS_DOMAIN_ID, in [0, 232].
  std::string name = "dfr";  ///< What discovery tools show.
  Discovery discovery = Discovery::kLoopback;
  std::string server_address = "127.0.0.1";  ///< IPv4, with the two kinds of discovery by server.
  std::uint16_t server_port = 11811;
  /// Shared memory towards processes on this machine, for images: a second participant beside that
  /// of the control loop, which stays on UDP, because a killed process can leave shared memory in
  /// a state that stalls others, and files in /dev/shm. Those that hold pictures, of processes that
  /// are no more, are removed here.
  bool shared_memory = false;
  /// The participant's folder in a secured network (security.h), where only participants with a
  /// certificate of the same authority hear and are heard, encrypted. Empty: anybody.
  std::filesystem::path security = {};
};

/// A participant that is there but neither hears nor is heard, for reasons of security. What it
/// says of itself is not proven.
struct RefusedPeer {
  std::string name;    ///< As its ParticipantOptions::name or ROS 2's enclave.
  std::string guid;    ///< As discovery tools show it: the machine, its process, its participant.
  std::string reason;  ///< In words: no certificate, one of another authority, ...
};

/// Who sent a sample: the publisher's GUID, which no other publisher has.
using Origin = std::array<std::uint8_t, 16>;

/// A participant or a publisher of another process. What it says of itself is not proven.
struct Newcomer {
  std::uint64_t number = 0;  ///< Counts all that were found, from 1 on.
  Origin origin{};           ///< The publisher's GUID, or the participant's.
  std::string name;          ///< The participant's; empty if it gives none.
  std::string address;       ///< "192.168.1.5", or "?" if it gives none.
  std::string topic;         ///< ROS 2 name of what it publishes; empty: the participant itself.
};

/// "'NAME' at ADDRESS" and what it publishes. Control characters are question marks, and a long
/// name is cut.
[[nodiscard]] std::string Describe(const Newcomer& newcomer);

/// A process' membership in a DDS domain (Fast DDS 2.9): what publishers and subscribers are made
/// from, which have to be destroyed first. Fast DDS runs threads of its own. Safe to use from
/// several threads.
class Participant {
 public:
  /// @throws std::invalid_argument if an option is out of range; std::runtime_error if the
  ///   participant cannot be made: no ports left in the domain, address not of this machine; or
  ///   what CheckSecurity() finds.
  explicit Participant(const ParticipantOptions& options);
  ~Participant();
  Participant(const Participant&) = delete;
  Participant& operator=(const Participant&) = delete;

  [[nodiscard]] const ParticipantOptions& options() const noexcept;

  /// The peers found since the start and not admitted, those that have left included; each appears
  /// within 5 s of its discovery. A peer that is missing here is absent or was admitted. Also works
  /// without security, for peers that have it.
  [[nodiscard]] std::vector<RefusedPeer> refused_peers() const;
  /// The refused peers that no earlier call has returned. A log line for each appears only once.
  [[nodiscard]] std::vector<RefusedPeer> TakeRefusedPeers();

  /// Publishers that other participants have on topics whose ROS 2 name `counts`, whatever their
  /// types and qualities of service. Through a discovery server only those are known that this
  /// process subscribes to.
  [[nodiscard]] int CountOthersPublishers(
      const std::function<bool(std::string_view topic)>& counts) const;

  /// How many participants and publishers of others have been found since the start. One that was
  /// forgotten and found again counts twice. In a secured network those whose certificate is of
  /// another authority, or who have none, do not count.
  [[nodiscard]] std::uint64_t num_found() const noexcept;
  /// Those found after number `after`, those that have left included, oldest first: up to the last
  /// 64. A participant is found before its publishers, and before any of its samples counts.
  [[nodiscard]] std::vector<Newcomer> FoundAfter(std::uint64_t after) const;
  /// The publishers behind CountOthersPublishers(), by number.
  [[nodiscard]] std::vector<Newcomer> OthersPublishers(
      const std::function<bool(std::string_view topic)>& counts) const;
  /// Whose publisher sent a sample; its origin alone if it has left, or was never found.
  [[nodiscard]] Newcomer PublisherOf(const Origin& origin) const;

  struct Impl;
  [[nodiscard]] Impl& impl() noexcept { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

/// For the end of a complaint that nobody answers: "; 'NAME' is there, and not admitted: REASON"
/// for each of the participant's refused_peers().
[[nodiscard]] std::string ExplainRefused(const Participant& participant);

}  // namespace dfr::dds
