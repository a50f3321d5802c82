#include "dfr/dds/participant.h"

#include <fastdds/rtps/attributes/ServerAttributes.h>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/rtps/transport/shared_mem/SharedMemTransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/qos/DomainParticipantQos.hpp>
#include <stdexcept>

#include "dfr/core/contract.h"
#include "participant_impl.h"

namespace dfr::dds {
namespace {

namespace fdds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using eprosima::fastrtps::Duration_t;

// Processes on one machine and in one domain that a loopback participant looks for.
constexpr std::uint32_t kLoopbackPeers = 24;
// The prefix that Fast DDS tools give to a server with id 0.
constexpr const char* kServerPrefix = "44.53.00.5f.45.50.52.4f.53.49.4d.41";

rtps::Locator_t Ipv4(const std::string& address, std::uint16_t port) {
  rtps::Locator_t locator;
  locator.kind = LOCATOR_KIND_UDPv4;
  DFR_THROW_UNLESS(rtps::IPLocator::setIPv4(locator, address),
                   "server_address must be an IPv4 address, not '" << address << "'");
  locator.port = port;
  return locator;
}

fdds::DomainParticipantQos Qos(const ParticipantOptions& options) {
  fdds::DomainParticipantQos qos;
  qos.name(options.name);
  qos.transport().use_builtin_transports = false;
  auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  auto& builtin = qos.wire_protocol().builtin;
  // A peer that dies without a word is forgotten after 5 s; one whose first announcements were lost
  // is found half a second later.
  builtin.discovery_config.leaseDuration = Duration_t(5, 0);
  builtin.discovery_config.leaseDuration_announcementperiod = Duration_t(0, 500'000'000);
  switch (options.discovery) {
    case Discovery::kLoopback:
      udp->interfaceWhiteList.emplace_back("127.0.0.1");
      udp->maxInitialPeersRange = kLoopbackPeers;
      builtin.initialPeersList.push_back(Ipv4("127.0.0.1", 0));
      // Own locators of the metatraffic leave out its multicast one.
      builtin.metatrafficUnicastLocatorList.push_back(Ipv4("127.0.0.1", 0));
      break;
    case Discovery::kNetwork:
      break;
    case Discovery::kServerClient: {
      builtin.discovery_config.discoveryProtocol = rtps::DiscoveryProtocol_t::CLIENT;
      rtps::RemoteServerAttributes server;
      server.ReadguidPrefix(kServerPrefix);
      server.metatrafficUnicastLocatorList.push_back(
          Ipv4(options.server_address, options.server_port));
      builtin.discovery_config.m_DiscoveryServers.push_back(server);
      break;
    }
    case Discovery::kServer:
      builtin.discovery_config.discoveryProtocol = rtps::DiscoveryProtocol_t::SERVER;
      std::istringstream(kServerPrefix) >> qos.wire_protocol().prefix;
      builtin.metatrafficUnicastLocatorList.push_back(
          Ipv4(options.server_address, options.server_port));
      break;
  }
  qos.transport().user_transports.push_back(udp);
  if (options.shared_memory) {
    // With the defaults, an image of 0.9 MB takes 30 times as long.
    auto memory = std::make_shared<eprosima::fastdds::rtps::SharedMemTransportDescriptor>();
    memory->segment_size(8 << 20);
    memory->max_message_size(2 << 20);
    qos.transport().user_transports.push_back(memory);
  }
  return qos;
}

}  // namespace

Participant::Impl::~Impl() {
  if (participant == nullptr) return;
  participant->delete_contained_entities();
  fdds::DomainParticipantFactory::get_instance()->delete_participant(participant);
}

fdds::Topic* Participant::Impl::Topic(const std::string& ros_name, const fdds::TypeSupport& type) {
  DFR_THROW_UNLESS(
      ros_name.size() > 1 && ros_name.front() == '/',
      "a topic's name begins with a slash, '/PSM1/servo_cp': not '" << ros_name << "'");
  const std::lock_guard lock(mutex);
  if (const auto found = topics.find(ros_name); found != topics.end()) {
    if (found->second->get_type_name() != type.get_type_name()) {
      throw std::runtime_error("topic " + ros_name + " has type " + found->second->get_type_name() +
                               ", not " + type.get_type_name());
    }
    return found->second;
  }
  type.register_type(participant);
  fdds::Topic* topic =
      participant->create_topic("rt" + ros_name, type.get_type_name(), fdds::TOPIC_QOS_DEFAULT);
  if (topic == nullptr) {
    throw std::runtime_error("DDS refuses the topic " + ros_name + " of type " +
                             type.get_type_name());
  }
  topics.emplace(ros_name, topic);
  return topic;
}

Participant::Participant(const ParticipantOptions& options)
    : impl_(std::make_unique<Impl>(options)) {
  DFR_THROW_UNLESS(options.domain >= 0 && options.domain <= 232,
                   "domain must lie in [0, 232], not " << options.domain);
  DFR_THROW_UNLESS(options.server_port > 0, "server_port must be positive");
  auto* factory = fdds::DomainParticipantFactory::get_instance();
  impl_->participant =
      factory->create_participant(static_cast<fdds::DomainId_t>(options.domain), Qos(options));
  if (impl_->participant != nullptr) {
    impl_->publisher = impl_->participant->create_publisher(fdds::PUBLISHER_QOS_DEFAULT);
    impl_->subscriber = impl_->participant->create_subscriber(fdds::SUBSCRIBER_QOS_DEFAULT);
  }
  if (impl_->publisher == nullptr || impl_->subscriber == nullptr) {
    throw std::runtime_error("DDS refuses to make a participant in domain " +
                             std::to_string(options.domain) +
                             ": too many processes in it, or its UDP ports are taken; try another "
                             "domain");
  }
}

Participant::~Participant() = default;

const ParticipantOptions& Participant::options() const noexcept { return impl_->options; }

}  // namespace dfr::dds
