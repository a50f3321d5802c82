#include "dfr/dds/participant.h"

#include <fastdds/rtps/attributes/ServerAttributes.h>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/rtps/transport/shared_mem/SharedMemTransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>
#include <fastrtps/xmlparser/XMLProfileManager.h>

#include <algorithm>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/qos/DomainParticipantQos.hpp>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/error.h"
#include "dfr/core/text/format.h"
#include "dfr/dds/security.h"
#include "guarded_transport.h"
#include "participant_impl.h"
#include "security/openssl.h"
#include "stale_memory.h"

namespace dfr::dds {
namespace {

namespace fdds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using eprosima::fastrtps::Duration_t;

// Number of processes in a domain on this machine that a loopback participant can discover.
constexpr std::uint32_t kLoopbackPeers = 24;
// GUID prefix that Fast DDS tools assign to a server with id 0.
constexpr const char* kServerPrefix = "44.53.00.5f.45.50.52.4f.53.49.4d.41";

rtps::Locator_t Ipv4(const std::string& address, std::uint16_t port) {
  rtps::Locator_t locator;
  locator.kind = LOCATOR_KIND_UDPv4;
  DFR_THROW_UNLESS(rtps::IPLocator::setIPv4(locator, address),
                   "server_address must be an IPv4 address, not '" << address << "'");
  locator.port = port;
  return locator;
}

// Disables intraprocess delivery: participants in one process communicate as if in two.
// Intraprocess delivery of Fast DDS 2.9 crashes if an endpoint ends while another discovers it
// (StatefulWriter::intraprocess_gap calls a destroyed reader).
void LeaveOutDeliveryWithinTheProcess() {
  static const bool done = [] {
    auto settings = eprosima::fastrtps::xmlparser::XMLProfileManager::library_settings();
    settings.intraprocess_delivery = eprosima::fastrtps::INTRAPROCESS_OFF;
    eprosima::fastrtps::xmlparser::XMLProfileManager::library_settings(settings);
    return true;
  }();
  static_cast<void>(done);
}

// Maximum time that two participants need to admit each other, even on busy machines.
constexpr std::chrono::seconds kHandshake(5);

std::string GuidText(const rtps::GUID_t& guid) {
  std::ostringstream text;
  text << guid;
  return text.str();
}

Origin ToOrigin(const rtps::GUID_t& guid) noexcept {
  Origin origin;
  auto* const rest =
      std::copy_n(std::begin(guid.guidPrefix.value), rtps::GuidPrefix_t::size, origin.begin());
  std::copy_n(std::begin(guid.entityId.value), rtps::EntityId_t::size, rest);
  return origin;
}

// Returns the IPv4 address announced by a participant; "?" if there is none.
std::string AddressOf(const rtps::RemoteLocatorList& locators) {
  for (const rtps::Locator_t& locator : locators.unicast) {
    if (locator.kind == LOCATOR_KIND_UDPv4) return rtps::IPLocator::toIPv4string(locator);
  }
  return "?";
}

constexpr std::string_view kRos = "rt";  // precedes a topic's ROS 2 name
constexpr std::size_t kMostFound = 64;

std::string_view RosName(std::string_view topic) {
  return topic.starts_with(kRos) ? topic.substr(kRos.size()) : topic;
}

// Enables the built-in security plugins with one participant's files.
void Secure(const SecurityFiles& files, fdds::DomainParticipantQos& qos) {
  auto& properties = qos.properties().properties();
  const auto set = [&](const char* name, const std::string& value) {
    properties.emplace_back(name, value);
  };
  const auto file = [&](const char* name, const std::filesystem::path& path) {
    set(name, "file://" + std::filesystem::absolute(path).string());
  };
  set("dds.sec.auth.plugin", "builtin.PKI-DH");
  file("dds.sec.auth.builtin.PKI-DH.identity_ca", files.identity_ca);
  file("dds.sec.auth.builtin.PKI-DH.identity_certificate", files.certificate);
  file("dds.sec.auth.builtin.PKI-DH.private_key", files.key);
  set("dds.sec.access.plugin", "builtin.Access-Permissions");
  file("dds.sec.access.builtin.Access-Permissions.permissions_ca", files.permissions_ca);
  file("dds.sec.access.builtin.Access-Permissions.governance", files.governance);
  file("dds.sec.access.builtin.Access-Permissions.permissions", files.permissions);
  set("dds.sec.crypto.plugin", "builtin.AES-GCM-GMAC");
}

// Returns the common name of the authority whose certificates this participant admits; empty
// without security.
std::string Authority(const ParticipantOptions& options) {
  if (options.security.empty()) return {};
  CheckSecurity(options.security);
  const auto ca = internal::LoadCertificate(SecurityFiles(options.security).identity_ca);
  return internal::CommonName(*ca);
}

fdds::DomainParticipantQos Qos(const ParticipantOptions& options) {
  fdds::DomainParticipantQos qos;
  qos.name(options.name);
  qos.transport().use_builtin_transports = false;
  auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  // The system's default buffer holds only two or three fragments of an image. The other fragments
  // are lost, and resent after about ten milliseconds. The system limits this size to
  // net.core.rmem_max.
  udp->receiveBufferSize = 4 << 20;
  udp->sendBufferSize = 4 << 20;
  auto& builtin = qos.wire_protocol().builtin;
  // A peer that dies silently is removed after 5 s. A peer whose first announcements were lost is
  // discovered half a second later.
  builtin.discovery_config.leaseDuration = Duration_t(5, 0);
  builtin.discovery_config.leaseDuration_announcementperiod = Duration_t(0, 500'000'000);
  switch (options.discovery) {
    case Discovery::kLoopback:
      udp->interfaceWhiteList.emplace_back("127.0.0.1");
      udp->maxInitialPeersRange = kLoopbackPeers;
      builtin.initialPeersList.push_back(Ipv4("127.0.0.1", 0));
      // An explicit metatraffic locator replaces the multicast locator. Port index 0 selects the
      // first free port of the domain. By default Fast DDS 2.9 increments the index with each
      // participant ever created by the process, beyond the range that other processes probe.
      builtin.metatrafficUnicastLocatorList.push_back(
          Ipv4("127.0.0.1", static_cast<std::uint16_t>(qos.wire_protocol().port.getUnicastPort(
                                static_cast<std::uint32_t>(options.domain), 0))));
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
  qos.transport().user_transports.push_back(internal::Guarded(udp));
  if (options.shared_memory) {
    internal::RemoveStaleSegments();
    // With the default sizes, the transfer of an image of 0.9 MB takes 30 times as long.
    auto memory = std::make_shared<eprosima::fastdds::rtps::SharedMemTransportDescriptor>();
    memory->segment_size(8 << 20);
    memory->max_message_size(2 << 20);
    qos.transport().user_transports.push_back(internal::Guarded(memory));
  }
  if (!options.security.empty()) Secure(SecurityFiles(options.security), qos);
  return qos;
}

}  // namespace

void PeerListener::on_participant_discovery(fdds::DomainParticipant* /*participant*/,
                                            rtps::ParticipantDiscoveryInfo&& info) {
  using Info = rtps::ParticipantDiscoveryInfo;
  const std::lock_guard lock(mutex_);
  const std::string guid = GuidText(info.info.m_guid);
  if (info.status == Info::DISCOVERED_PARTICIPANT) {
    const auto& token = info.info.identity_token_;
    const std::string* authority = rtps::DataHolderHelper::find_property_value(token, "dds.ca.sn");
    const auto& metatraffic = info.info.metatraffic_locators;
    const Peer& peer = peers_[guid] = {
        .name = info.info.m_participantName.to_string(),
        .address =
            AddressOf(metatraffic.unicast.empty() ? info.info.default_locators : metatraffic),
        .has_certificate = !token.class_id().empty(),
        .authority = authority == nullptr ? std::string() : *authority,
        .found = Clock::now()};
    if (Outside(peer)) return;
    Newcomer newcomer{.origin = ToOrigin(info.info.m_guid),
                      .name = peer.name,
                      .address = peer.address,
                      .topic = {}};
    Found(newcomer);
  } else if (info.status != Info::CHANGED_QOS_PARTICIPANT) {
    // A peer that was admitted, or left before the decision, is no longer tracked.
    const auto peer = peers_.find(guid);
    if (peer != peers_.end() && Reason(peer->second).empty()) peers_.erase(peer);
  }
}

void PeerListener::on_publisher_discovery(fdds::DomainParticipant* participant,
                                          rtps::WriterDiscoveryInfo&& info) {
  if (info.info.guid().guidPrefix == participant->guid().guidPrefix) return;
  const std::lock_guard lock(mutex_);
  const rtps::GUID_t& guid = info.info.guid();
  if (info.status == rtps::WriterDiscoveryInfo::REMOVED_WRITER) {
    publishers_.erase(guid);
    return;
  }
  const auto [place, is_new] = publishers_.try_emplace(guid);
  if (!is_new) return;
  Newcomer& publisher = place->second;
  publisher.origin = ToOrigin(guid);
  publisher.topic = info.info.topicName().to_string();
  const auto peer =
      peers_.find(GuidText(rtps::GUID_t(guid.guidPrefix, rtps::c_EntityId_RTPSParticipant)));
  if (peer != peers_.end()) publisher.name = peer->second.name;
  publisher.address =
      peer != peers_.end() ? peer->second.address : AddressOf(info.info.remote_locators());
  Found(publisher);
}

void PeerListener::Found(Newcomer& newcomer) {
  newcomer.number = num_found_.load(std::memory_order_relaxed) + 1;
  found_.push_back(newcomer);
  found_.back().topic = RosName(newcomer.topic);
  if (found_.size() > kMostFound) found_.pop_front();
  num_found_.store(newcomer.number, std::memory_order_release);
}

int PeerListener::CountPublishers(const std::function<bool(std::string_view topic)>& counts) const {
  return static_cast<int>(Publishers(counts).size());
}

std::vector<Newcomer> PeerListener::Publishers(
    const std::function<bool(std::string_view topic)>& counts) const {
  std::vector<Newcomer> publishers;
  const std::lock_guard lock(mutex_);
  for (const auto& [guid, publisher] : publishers_) {
    const std::string_view topic = publisher.topic;
    if (!topic.starts_with(kRos) || !counts(RosName(topic))) continue;
    publishers.push_back(publisher);
    publishers.back().topic = RosName(topic);
  }
  std::ranges::sort(publishers, {}, &Newcomer::number);
  return publishers;
}

std::vector<Newcomer> PeerListener::FoundAfter(std::uint64_t after) const {
  const std::lock_guard lock(mutex_);
  std::vector<Newcomer> found;
  for (const Newcomer& newcomer : found_) {
    if (newcomer.number > after) found.push_back(newcomer);
  }
  return found;
}

Newcomer PeerListener::PublisherOf(const Origin& origin) const {
  const std::lock_guard lock(mutex_);
  for (const auto& [guid, publisher] : publishers_) {
    if (publisher.origin != origin) continue;
    Newcomer found = publisher;
    found.topic = RosName(publisher.topic);
    return found;
  }
  return {.origin = origin, .name = {}, .address = "?", .topic = {}};
}

bool PeerListener::Outside(const Peer& peer) const {
  return secured_ &&
         (!peer.has_certificate || peer.authority.find(authority_) == std::string::npos);
}

void PeerListener::onParticipantAuthentication(fdds::DomainParticipant* /*participant*/,
                                               rtps::ParticipantAuthenticationInfo&& info) {
  const std::lock_guard lock(mutex_);
  const auto peer = peers_.find(GuidText(info.guid));
  if (peer == peers_.end()) return;
  const bool admitted = info.status == rtps::ParticipantAuthenticationInfo::AUTHORIZED_PARTICIPANT;
  (admitted ? peer->second.admitted : peer->second.refused) = true;
}

std::string PeerListener::Reason(const Peer& peer) const {
  if (!secured_) {
    return peer.has_certificate ? "it belongs to a secured network, and this process has no "
                                  "certificate"
                                : "";
  }
  if (!peer.has_certificate) return "it has no certificate";
  if (peer.admitted) return "";
  // Only common names are compared, because implementations format full names differently.
  if (peer.authority.find(authority_) == std::string::npos) {
    return "its certificate is from the authority '" + peer.authority +
           "', but the certificate of this process is from '" + authority_ + "'";
  }
  if (peer.refused) return "its certificate or its permissions are forged, or have expired";
  // A peer that rejects this process's certificate only stays silent.
  return Clock::now() - peer.found < kHandshake ? ""
                                                : "it does not accept this process's certificate, "
                                                  "or does not answer";
}

std::vector<RefusedPeer> PeerListener::refused() const {
  const std::lock_guard lock(mutex_);
  std::vector<RefusedPeer> refused;
  for (const auto& [guid, peer] : peers_) {
    std::string reason = Reason(peer);
    if (!reason.empty()) refused.push_back({peer.name, guid, std::move(reason)});
  }
  return refused;
}

std::vector<RefusedPeer> PeerListener::TakeRefused() {
  const std::lock_guard lock(mutex_);
  std::vector<RefusedPeer> refused;
  for (auto& [guid, peer] : peers_) {
    std::string reason = peer.told ? std::string() : Reason(peer);
    if (reason.empty()) continue;
    refused.push_back({peer.name, guid, std::move(reason)});
    peer.told = true;
  }
  return refused;
}

Participant::Impl::~Impl() {
  if (participant == nullptr) return;
  internal::ParticipantPrefix prefix;
  std::copy_n(participant->guid().guidPrefix.value, prefix.size(), prefix.begin());
  internal::Leaves(prefix);
  participant->delete_contained_entities();
  fdds::DomainParticipantFactory::get_instance()->delete_participant(participant);
}

fdds::Topic* Participant::Impl::Topic(const std::string& ros_name, const fdds::TypeSupport& type,
                                      const std::string& kind) {
  DFR_THROW_UNLESS(
      ros_name.size() > 1 && ros_name.front() == '/',
      "a topic must begin with a slash, such as '/PSM1/servo_cp', not '" << ros_name << "'");
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
      participant->create_topic(kind + ros_name, type.get_type_name(), fdds::TOPIC_QOS_DEFAULT);
  if (topic == nullptr) {
    throw std::runtime_error("DDS refuses the topic " + ros_name + " of type " +
                             type.get_type_name());
  }
  topics.emplace(ros_name, topic);
  return topic;
}

Participant::Participant(const ParticipantOptions& options)
    : impl_(std::make_unique<Impl>(options, Authority(options))) {
  DFR_THROW_UNLESS(options.domain >= 0 && options.domain <= 232,
                   "domain must lie in [0, 232], not " << options.domain);
  DFR_THROW_UNLESS(options.server_port > 0,
                   "server_port must be positive, not " << options.server_port);
  auto* factory = fdds::DomainParticipantFactory::get_instance();
  LeaveOutDeliveryWithinTheProcess();
  impl_->participant =
      factory->create_participant(static_cast<fdds::DomainId_t>(options.domain), Qos(options),
                                  &impl_->listener, fdds::StatusMask::none());
  if (impl_->participant != nullptr) {
    impl_->publisher = impl_->participant->create_publisher(fdds::PUBLISHER_QOS_DEFAULT);
    impl_->subscriber = impl_->participant->create_subscriber(fdds::SUBSCRIBER_QOS_DEFAULT);
  }
  if (impl_->publisher == nullptr || impl_->subscriber == nullptr) {
    throw core::Error(
        "DDS cannot create a participant in domain " + std::to_string(options.domain) +
            ": too many processes in it, or its UDP ports are taken",
        "try another domain" + (options.security.empty()
                                    ? std::string()
                                    : ", or check whether the governance and permissions in " +
                                          options.security.string() + " cover this domain"));
  }
}

Participant::~Participant() = default;

std::vector<RefusedPeer> Participant::refused_peers() const { return impl_->listener.refused(); }

std::vector<RefusedPeer> Participant::TakeRefusedPeers() { return impl_->listener.TakeRefused(); }

std::string ExplainRefused(const Participant& participant) {
  std::string text;
  for (const RefusedPeer& peer : participant.refused_peers()) {
    text += "; '" + peer.name + "' is present, but not admitted: " + peer.reason;
  }
  return text;
}

int Participant::CountOthersPublishers(
    const std::function<bool(std::string_view topic)>& counts) const {
  return impl_->listener.CountPublishers(counts);
}

std::uint64_t Participant::num_found() const noexcept { return impl_->listener.num_found(); }

std::vector<Newcomer> Participant::FoundAfter(std::uint64_t after) const {
  return impl_->listener.FoundAfter(after);
}

std::vector<Newcomer> Participant::OthersPublishers(
    const std::function<bool(std::string_view topic)>& counts) const {
  return impl_->listener.Publishers(counts);
}

Newcomer Participant::PublisherOf(const Origin& origin) const {
  return impl_->listener.PublisherOf(origin);
}

std::string Describe(const Newcomer& newcomer) {
  constexpr std::size_t kMost = 32;
  const bool is_long = newcomer.name.size() > kMost;
  std::string text =
      "'" + newcomer.name.substr(0, kMost) + (is_long ? "...' at " : "' at ") + newcomer.address;
  if (!newcomer.topic.empty()) text += " publishes " + newcomer.topic;
  core::MakePrintable(text);
  return text;
}

const ParticipantOptions& Participant::options() const noexcept { return impl_->options; }

}  // namespace dfr::dds
