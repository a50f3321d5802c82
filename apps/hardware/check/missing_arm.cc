#include "check/missing_arm.h"

#include <algorithm>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include "check/findings.h"
#include "dfr/dds/channel.h"

namespace dfr::apps::hardware_app {
namespace {

// Returns the other arms that publish on the network within `seconds`.
std::vector<std::string> OtherArms(const CheckOptions& options, double seconds) {
  dds::Participant participant(options.network);
  struct Candidate {
    std::string name;
    std::unique_ptr<dds::Subscriber<dds::JointState>> subscriber;
  };
  std::vector<Candidate> candidates;
  for (const char* name : {"PSM1", "PSM2", "PSM3", "ECM", "MTML", "MTMR"}) {
    if (name == options.arm) continue;
    candidates.push_back(
        {name, std::make_unique<dds::Subscriber<dds::JointState>>(
                   participant, std::string("/") + name + "/measured_js", dds::Role::kState)});
  }
  std::vector<std::string> found;
  (void)Within(*options.clock, seconds, [&] {
    found.clear();
    for (const Candidate& candidate : candidates) {
      if (candidate.subscriber->health().publishers > 0) found.push_back(candidate.name);
    }
    return !found.empty();
  });
  return found;
}

bool PublishedIn(const dds::ParticipantOptions& network, const std::string& topic, double seconds,
                 Clock& clock) {
  dds::Participant participant(network);
  const dds::Subscriber<dds::JointState> subscriber(participant, topic, dds::Role::kState);
  return Within(clock, seconds, [&] { return subscriber.health().publishers > 0; });
}

// Reports participants that security does not admit.
void ExplainRefused(const CheckOptions& options, const dds::Participant& participant,
                    DeviceReport& report) {
  for (const dds::RefusedPeer& peer : participant.refused_peers()) {
    Wrong(report, "'" + peer.name + "' is present, but not admitted: " + peer.reason,
          options.network.security.empty()
              ? "give --security with a folder of that network's `hardware certificates`"
              : "give both folders of the same `hardware certificates`");
  }
}

// Reports why no console was found: another domain, another kind of discovery, another arm.
void ExplainSilence(const CheckOptions& options, DeviceReport& report) {
  const std::string topic = "/" + options.arm + "/measured_js";
  const double seconds = std::min(options.find_s, 2.0);
  std::string remedy = "start the console (or dvrk_simulator); its ROS_DOMAIN_ID must be " +
                       std::to_string(options.network.domain) + " and its network reachable";
  for (const dds::Discovery other : {dds::Discovery::kNetwork, dds::Discovery::kLoopback}) {
    dds::ParticipantOptions network = options.network;
    if (other == network.discovery || network.discovery == dds::Discovery::kServerClient) continue;
    network.discovery = other;
    if (PublishedIn(network, topic, seconds, *options.clock)) {
      remedy = std::string("it is found with --discovery ") + Name(other) + ": give that option";
    }
  }
  const char* text = std::getenv("ROS_DOMAIN_ID");
  char* end = nullptr;
  const long domain = text == nullptr ? 0 : std::strtol(text, &end, 10);
  if (text != nullptr && end != text && domain != options.network.domain && domain >= 0 &&
      domain <= 232) {
    dds::ParticipantOptions network = options.network;
    network.domain = static_cast<int>(domain);
    if (PublishedIn(network, topic, seconds, *options.clock)) {
      remedy = "it is in the domain of ROS_DOMAIN_ID: give --domain " + std::string(text);
    }
  }
  Say(options, "looking for other arms");
  const std::vector<std::string> others = OtherArms(options, seconds);
  if (!others.empty()) {
    remedy = "there is " + others.front();
    for (std::size_t i = 1; i < others.size(); ++i) remedy += ", " + others[i];
    remedy += ": give --arm, or configure the console for " + options.arm;
  }
  Wrong(report,
        "no program publishes " + topic + " in domain " + std::to_string(options.network.domain) +
            " (discovery: " + Name(options.network.discovery) + ")",
        remedy);
}

}  // namespace

void ExplainMissing(const CheckOptions& options, const dds::Participant& participant,
                    DeviceReport& report) {
  ExplainRefused(options, participant, report);
  if (report.ok()) ExplainSilence(options, report);
}

}  // namespace dfr::apps::hardware_app
