#pragma once

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <map>
#include <mutex>
#include <string>

#include "dfr/dds/participant.h"

namespace dfr::dds {

struct Participant::Impl {
  explicit Impl(const ParticipantOptions& chosen) : options(chosen) {}
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  /// The DDS topic of a ROS 2 topic, made if it is new.
  eprosima::fastdds::dds::Topic* Topic(const std::string& ros_name,
                                       const eprosima::fastdds::dds::TypeSupport& type);

  ParticipantOptions options;
  eprosima::fastdds::dds::DomainParticipant* participant = nullptr;
  eprosima::fastdds::dds::Publisher* publisher = nullptr;
  eprosima::fastdds::dds::Subscriber* subscriber = nullptr;
  std::mutex mutex;
  std::map<std::string, eprosima::fastdds::dds::Topic*> topics;
};

}  // namespace dfr::dds
