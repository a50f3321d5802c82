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

/// Discovery mechanism between processes.
enum class Discovery {
  kLoopback,      ///< Processes on this machine only. Needs no multicast.
  kNetwork,       ///< All processes on the local network, by multicast, as in ROS 2.
  kServerClient,  ///< Through a discovery server, for networks without multicast.
  kServer,        ///< Acts as the discovery server.
};

/// Options for Participant.
struct ParticipantOptions {
  int domain = 0;            ///< Same as ROS_DOMAIN_ID, in [0, 232].
  std::string name = "dfr";  ///< Name shown by discovery tools.
  Discovery discovery = Discovery::kLoopback;
  std::string server_address = "127.0.0.1";  ///< IPv4 address of the discovery server.
  std::uint16_t server_port = 11811;
  /// Adds a shared memory transport for images between processes on this machine, and removes the
  /// segments of terminated processes from /dev/shm. Use a separate participant for images, and
  /// keep the control loop's participant on UDP: a killed process can leave shared memory in a
  /// state that stalls other processes.
  bool shared_memory = false;
  /// Folder of the participant in a secured network (security.h). Only participants with a
  /// certificate of the same authority can communicate, and all traffic is encrypted. Empty: no
  /// security.
  std::filesystem::path security = {};
};

/// A discovered participant that security excludes from communication. Its self-description is
/// unverified.
struct RefusedPeer {
  std::string name;    ///< ParticipantOptions::name or ROS 2 enclave of the participant.
  std::string guid;    ///< Identifier of the participant, as shown by discovery tools.
  std::string reason;  ///< Description: no certificate, a certificate of another authority, ...
};

/// Sender of a sample: the publisher's GUID, which is unique.
using Origin = std::array<std::uint8_t, 16>;

/// Another participant, or one of its publishers. Its self-description is unverified.
struct Newcomer {
  std::uint64_t number = 0;  ///< Number in order of discovery, from 1.
  Origin origin{};           ///< GUID of the publisher or participant.
  std::string name;          ///< Name of the participant; empty if unknown.
  std::string address;       ///< "192.168.1.5", or "?" if unknown.
  std::string topic;  ///< ROS 2 name of the published topic; empty for the participant itself.
};

/// Returns "'NAME' at ADDRESS" and the published topic. Replaces control characters with question
/// marks and truncates a long name.
[[nodiscard]] std::string Describe(const Newcomer& newcomer);

/// Membership of a process in a DDS domain (Fast DDS 2.9). Publishers and subscribers are created
/// from it and must be destroyed before it. Fast DDS creates its own threads. Thread-safe.
class Participant {
 public:
  /// @throws std::invalid_argument if an option is out of range; std::runtime_error if the
  ///   participant cannot be created (the domain has no free port, or the address does not belong
  ///   to this machine), and as CheckSecurity().
  explicit Participant(const ParticipantOptions& options);
  ~Participant();
  Participant(const Participant&) = delete;
  Participant& operator=(const Participant&) = delete;

  [[nodiscard]] const ParticipantOptions& options() const noexcept;

  /// Returns the peers refused since the start, including those that have left. Each appears within
  /// 5 s of its discovery. Without security, the list contains the peers that use security.
  [[nodiscard]] std::vector<RefusedPeer> refused_peers() const;
  /// Returns the refused peers not returned by earlier calls, for a log without repetitions.
  [[nodiscard]] std::vector<RefusedPeer> TakeRefusedPeers();

  /// Counts the publishers of other participants on topics whose ROS 2 name `counts` accepts,
  /// regardless of type and quality of service. With a discovery server, only topics to which this
  /// process subscribes are visible.
  [[nodiscard]] int CountOthersPublishers(
      const std::function<bool(std::string_view topic)>& counts) const;

  /// Returns the number of other participants and their publishers found since the start. A
  /// participant that is lost and rediscovered counts twice. With security, participants without a
  /// certificate of the network's authority do not count.
  [[nodiscard]] std::uint64_t num_found() const noexcept;
  /// Returns the participants and publishers found after number `after`, at most the last 64,
  /// oldest first, including those that have left. A participant is reported before its publishers
  /// and before any of its samples is accepted.
  [[nodiscard]] std::vector<Newcomer> FoundAfter(std::uint64_t after) const;
  /// Returns the publishers counted by CountOthersPublishers(), ordered by number.
  [[nodiscard]] std::vector<Newcomer> OthersPublishers(
      const std::function<bool(std::string_view topic)>& counts) const;
  /// Returns the publisher of a sample. Only the origin is set if the publisher has left or was
  /// never found.
  [[nodiscard]] Newcomer PublisherOf(const Origin& origin) const;

  struct Impl;
  [[nodiscard]] Impl& impl() noexcept { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

/// Returns a suffix for an error about a missing peer: "; 'NAME' is present, but not admitted:
/// REASON" for each of the participant's refused_peers().
[[nodiscard]] std::string ExplainRefused(const Participant& participant);

}  // namespace dfr::dds
