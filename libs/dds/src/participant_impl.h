#pragma once

#include <atomic>
#include <chrono>
#include <deque>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/dds/participant.h"

namespace dfr::dds {

/// Records participants and publishers when DDS discovers, admits or refuses them.
class PeerListener : public eprosima::fastdds::dds::DomainParticipantListener {
 public:
  /// @param authority  common name of the authority whose certificates are admitted.
  PeerListener(bool secured, std::string authority)
      : secured_(secured), authority_(std::move(authority)) {}

  void on_participant_discovery(eprosima::fastdds::dds::DomainParticipant* participant,
                                eprosima::fastrtps::rtps::ParticipantDiscoveryInfo&& info) override;
  void onParticipantAuthentication(
      eprosima::fastdds::dds::DomainParticipant* participant,
      eprosima::fastrtps::rtps::ParticipantAuthenticationInfo&& info) override;
  void on_publisher_discovery(eprosima::fastdds::dds::DomainParticipant* participant,
                              eprosima::fastrtps::rtps::WriterDiscoveryInfo&& info) override;
  [[nodiscard]] int CountPublishers(
      const std::function<bool(std::string_view topic)>& counts) const;
  [[nodiscard]] std::vector<Newcomer> Publishers(
      const std::function<bool(std::string_view topic)>& counts) const;
  [[nodiscard]] std::vector<Newcomer> FoundAfter(std::uint64_t after) const;
  [[nodiscard]] Newcomer PublisherOf(const Origin& origin) const;
  [[nodiscard]] std::uint64_t num_found() const noexcept {
    return num_found_.load(std::memory_order_acquire);
  }
  [[nodiscard]] std::vector<RefusedPeer> refused() const;
  [[nodiscard]] std::vector<RefusedPeer> TakeRefused();

 private:
  using Clock = std::chrono::steady_clock;
  struct Peer {
    std::string name;
    std::string address;
    bool has_certificate = false;
    std::string authority;
    Clock::time_point found;
    bool admitted = false;
    bool refused = false;
    bool told = false;
  };
  [[nodiscard]] std::string Reason(const Peer& peer) const;
  // Returns true if a secured network does not admit the peer.
  [[nodiscard]] bool Outside(const Peer& peer) const;
  // Numbers the newcomer and adds it to found_. @pre the mutex is locked
  void Found(Newcomer& newcomer);

  const bool secured_;
  const std::string authority_;
  mutable std::mutex mutex_;
  std::map<std::string, Peer> peers_;                                // by GUID
  std::map<eprosima::fastrtps::rtps::GUID_t, Newcomer> publishers_;  // with DDS topic names
  std::deque<Newcomer> found_;
  std::atomic<std::uint64_t> num_found_{0};
};

struct Participant::Impl {
  Impl(const ParticipantOptions& chosen, std::string authority)
      : options(chosen), listener(!chosen.security.empty(), std::move(authority)) {}
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  /// Returns the DDS topic of a ROS 2 topic; creates it if necessary.
  /// @param kind  "rt" for topics, "rq" for a service's requests, "rr" for its replies.
  eprosima::fastdds::dds::Topic* Topic(const std::string& ros_name,
                                       const eprosima::fastdds::dds::TypeSupport& type,
                                       const std::string& kind = "rt");

  ParticipantOptions options;
  PeerListener listener;
  eprosima::fastdds::dds::DomainParticipant* participant = nullptr;
  eprosima::fastdds::dds::Publisher* publisher = nullptr;
  eprosima::fastdds::dds::Subscriber* subscriber = nullptr;
  std::mutex mutex;
  std::map<std::string, eprosima::fastdds::dds::Topic*> topics;
};

}  // namespace dfr::dds
