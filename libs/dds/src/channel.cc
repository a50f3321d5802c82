#include "dfr/dds/channel.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/qos/DataWriterQos.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/qos/DataReaderQos.hpp>
#include <stdexcept>

#include "participant_impl.h"
#include "wire.h"

namespace dfr::dds {
namespace {

namespace fdds = eprosima::fastdds::dds;
using eprosima::fastrtps::Duration_t;
using eprosima::fastrtps::types::ReturnCode_t;

constexpr std::uint32_t kMillisecond = 1'000'000;
constexpr int kConsoleDepth = 100;

bool Latched(Role role) { return role == Role::kEvent || role == Role::kEmergencyStop; }

// Deadline and liveliness, offered by a writer of commands.
void Offer(fdds::DataWriterQos& qos) {
  qos.deadline().period = Duration_t(0, 40 * kMillisecond);
  qos.liveliness().kind = fdds::MANUAL_BY_TOPIC_LIVELINESS_QOS;
  qos.liveliness().lease_duration = Duration_t(0, 100 * kMillisecond);
  qos.liveliness().announcement_period = Duration_t(0, 50 * kMillisecond);
}

// An old command must never be executed, wherever it was delayed.
const Duration_t kCommandLifespan(0, 50 * kMillisecond);

int WriterDepth(Role role) {
  switch (role) {
    case Role::kState:
    case Role::kEvent:
    case Role::kRequest:
      return kConsoleDepth;
    case Role::kEmergencyStop:
      return 10;  // a press reaches late joiners even if released at once
    case Role::kCommand:
    case Role::kImage:
    case Role::kSensorImage:
      return 1;
  }
  return 1;
}

fdds::ReliabilityQosPolicyKind Reliability(Role role) {
  return role == Role::kSensorImage ? fdds::BEST_EFFORT_RELIABILITY_QOS
                                    : fdds::RELIABLE_RELIABILITY_QOS;
}

fdds::DataWriterQos WriterQos(Role role) {
  fdds::DataWriterQos qos = fdds::DATAWRITER_QOS_DEFAULT;
  qos.reliability().kind = Reliability(role);
  qos.reliability().max_blocking_time = Duration_t(0, 100 * kMillisecond);
  // By default Fast DDS shares memory for types of fixed size, regardless of the transports.
  qos.data_sharing().off();
  // Strings and sequences have no maximum size.
  qos.endpoint().history_memory_policy =
      eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
  qos.history().kind = fdds::KEEP_LAST_HISTORY_QOS;
  qos.history().depth = WriterDepth(role);
  qos.durability().kind =
      Latched(role) ? fdds::TRANSIENT_LOCAL_DURABILITY_QOS : fdds::VOLATILE_DURABILITY_QOS;
  // A late joiner receives the kept samples at the next heartbeat, which also triggers the request
  // for a lost sample.
  qos.reliable_writer_qos().times.heartbeatPeriod = Duration_t(0, 100 * kMillisecond);
  if (role == Role::kCommand) {
    Offer(qos);
    qos.lifespan().duration = kCommandLifespan;
  }
  if (role == Role::kImage || role == Role::kSensorImage)
    qos.publish_mode().kind = fdds::ASYNCHRONOUS_PUBLISH_MODE;
  return qos;
}

fdds::DataReaderQos ReaderQos(Role role) {
  fdds::DataReaderQos qos = fdds::DATAREADER_QOS_DEFAULT;
  qos.reliability().kind = Reliability(role);
  qos.data_sharing().off();
  qos.endpoint().history_memory_policy =
      eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
  qos.history().kind = fdds::KEEP_LAST_HISTORY_QOS;
  qos.history().depth =
      role == Role::kEvent || role == Role::kRequest || role == Role::kEmergencyStop ? kConsoleDepth
                                                                                     : 1;
  qos.durability().kind =
      Latched(role) ? fdds::TRANSIENT_LOCAL_DURABILITY_QOS : fdds::VOLATILE_DURABILITY_QOS;
  if (role == Role::kCommand) qos.lifespan().duration = kCommandLifespan;
  return qos;
}

Duration_t Seconds(double seconds) {
  const double whole = std::floor(seconds);
  return {static_cast<std::int32_t>(whole), static_cast<std::uint32_t>(1e9 * (seconds - whole))};
}

Origin ToOrigin(const fdds::InstanceHandle_t& handle) noexcept {
  const eprosima::fastrtps::rtps::octet* const bytes = handle.value;
  Origin origin;
  std::copy_n(bytes, origin.size(), origin.begin());
  return origin;
}

[[noreturn]] void Refused(const char* what, const std::string& topic) {
  throw std::runtime_error("DDS cannot create a " + std::string(what) + " of " + topic +
                           "; check that this domain's security profile permits it");
}

}  // namespace

template <typename T>
struct Publisher<T>::Impl {
  Participant::Impl& participant;
  fdds::DataWriter* writer = nullptr;
  typename internal::WireOf<T>::Type wire;
};

template <typename T>
Publisher<T>::Publisher(Participant& participant, const std::string& topic, Role role)
    : impl_(std::make_unique<Impl>(Impl{participant.impl(), nullptr, {}})) {
  Participant::Impl& owner = participant.impl();
  fdds::Topic* dds_topic =
      owner.Topic(topic, fdds::TypeSupport(new typename internal::WireOf<T>::Support()));
  fdds::DataWriterQos qos = WriterQos(role);
  // Fast DDS 2.9 ends the process if the last subscriber leaves while another thread encrypts a
  // sample.
  if (!owner.options.security.empty()) qos.publish_mode().kind = fdds::SYNCHRONOUS_PUBLISH_MODE;
  impl_->writer = owner.publisher->create_datawriter(dds_topic, qos);
  if (impl_->writer == nullptr) Refused("publisher", topic);
}

template <typename T>
Publisher<T>::~Publisher() {
  impl_->participant.publisher->delete_datawriter(impl_->writer);
}

template <typename T>
bool Publisher<T>::Write(const T& message) noexcept {
  try {
    internal::ToWire(message, impl_->wire);
    return impl_->writer->write(&impl_->wire);
  } catch (const std::exception&) {
    return false;
  }
}

template <typename T>
bool Publisher<T>::WaitUntilReceived(double timeout_s) noexcept {
  return impl_->writer->wait_for_acknowledgments(Seconds(timeout_s)) == ReturnCode_t::RETCODE_OK;
}

template <typename T>
int Publisher<T>::num_subscribers() const noexcept {
  fdds::PublicationMatchedStatus status;
  impl_->writer->get_publication_matched_status(status);
  return status.current_count;
}

template <typename T>
Origin Publisher<T>::origin() const noexcept {
  return ToOrigin(impl_->writer->get_instance_handle());
}

template <typename T>
struct Subscriber<T>::Impl {
  Participant::Impl& participant;
  fdds::DataReader* reader = nullptr;
  typename internal::WireOf<T>::Type wire;
};

template <typename T>
Subscriber<T>::Subscriber(Participant& participant, const std::string& topic, Role role)
    : impl_(std::make_unique<Impl>(Impl{participant.impl(), nullptr, {}})) {
  Participant::Impl& owner = participant.impl();
  fdds::Topic* dds_topic =
      owner.Topic(topic, fdds::TypeSupport(new typename internal::WireOf<T>::Support()));
  impl_->reader = owner.subscriber->create_datareader(dds_topic, ReaderQos(role));
  if (impl_->reader == nullptr) Refused("subscriber", topic);
}

template <typename T>
Subscriber<T>::~Subscriber() {
  impl_->participant.subscriber->delete_datareader(impl_->reader);
}

template <typename T>
bool Subscriber<T>::Take(T& message) noexcept {
  Origin from;
  return Take(message, from);
}

template <typename T>
bool Subscriber<T>::Take(T& message, Origin& from) noexcept {
  try {
    fdds::SampleInfo info;
    // Samples without data announce the departure of a publisher.
    while (impl_->reader->take_next_sample(&impl_->wire, &info) == ReturnCode_t::RETCODE_OK) {
      if (!info.valid_data) continue;
      internal::FromWire(impl_->wire, message);
      from = ToOrigin(info.publication_handle);
      return true;
    }
  } catch (const std::exception&) {
    return false;
  }
  return false;
}

template <typename T>
bool Subscriber<T>::TakeNewest(T& message) noexcept {
  bool any = false;
  while (Take(message)) any = true;
  return any;
}

template <typename T>
bool Subscriber<T>::Wait(double timeout_s) noexcept {
  return impl_->reader->wait_for_unread_message(Seconds(timeout_s));
}

template <typename T>
Health Subscriber<T>::health() const noexcept {
  Health health;
  fdds::SubscriptionMatchedStatus matched;
  impl_->reader->get_subscription_matched_status(matched);
  health.publishers = matched.current_count;
  health.found = matched.total_count;
  fdds::RequestedIncompatibleQosStatus incompatible;
  impl_->reader->get_requested_incompatible_qos_status(incompatible);
  health.incompatible = static_cast<int>(incompatible.total_count);
  return health;
}

template <typename Query, typename Answer>
struct Service<Query, Answer>::Impl {
  Participant::Impl& participant;
  fdds::DataReader* reader = nullptr;
  fdds::DataWriter* writer = nullptr;
  typename internal::WireOf<Query>::Type query;
  typename internal::WireOf<Answer>::Type answer;
};

template <typename Query, typename Answer>
Service<Query, Answer>::Service(Participant& participant, const std::string& name)
    : impl_(std::make_unique<Impl>(Impl{participant.impl(), nullptr, nullptr, {}, {}})) {
  Participant::Impl& owner = participant.impl();
  fdds::Topic* answers = owner.Topic(
      name + "Reply", fdds::TypeSupport(new typename internal::WireOf<Answer>::Support()), "rr");
  fdds::Topic* queries = owner.Topic(
      name + "Request", fdds::TypeSupport(new typename internal::WireOf<Query>::Support()), "rq");
  impl_->writer = owner.publisher->create_datawriter(answers, WriterQos(Role::kRequest));
  if (impl_->writer == nullptr) Refused("service", name);
  impl_->reader = owner.subscriber->create_datareader(queries, ReaderQos(Role::kRequest));
  if (impl_->reader == nullptr) {
    owner.publisher->delete_datawriter(impl_->writer);
    Refused("service", name);
  }
}

template <typename Query, typename Answer>
Service<Query, Answer>::~Service() {
  impl_->participant.subscriber->delete_datareader(impl_->reader);
  impl_->participant.publisher->delete_datawriter(impl_->writer);
}

template <typename Query, typename Answer>
int Service<Query, Answer>::Serve(const std::function<Answer(const Query&)>& answer) {
  int served = 0;
  fdds::SampleInfo info;
  while (impl_->reader->take_next_sample(&impl_->query, &info) == ReturnCode_t::RETCODE_OK) {
    if (!info.valid_data) continue;
    Query query;
    internal::FromWire(impl_->query, query);
    internal::ToWire(answer(query), impl_->answer);
    // A client recognises its reply by the request's number and by the addressee: its reader if the
    // request names one, otherwise its writer.
    eprosima::fastrtps::rtps::WriteParams params;
    const auto& reader = info.related_sample_identity.writer_guid();
    params.related_sample_identity().sequence_number(info.sample_identity.sequence_number());
    params.related_sample_identity().writer_guid(
        reader == eprosima::fastrtps::rtps::GUID_t::unknown() ? info.sample_identity.writer_guid()
                                                              : reader);
    impl_->writer->write(&impl_->answer, params);
    ++served;
  }
  return served;
}

template class Publisher<PoseStamped>;
template class Publisher<TwistStamped>;
template class Publisher<JointState>;
template class Publisher<OperatingState>;
template class Publisher<StringStamped>;
template class Publisher<Joy>;
template class Publisher<Image>;
template class Publisher<CompressedImage>;
template class Publisher<CameraInfo>;
template class Publisher<Text>;
template class Publisher<Flag>;
template class Publisher<Signal>;
template class Publisher<WrenchStamped>;
template class Publisher<CartesianState>;
template class Publisher<Number>;
template class Publisher<Matrix>;
template class Subscriber<PoseStamped>;
template class Subscriber<TwistStamped>;
template class Subscriber<JointState>;
template class Subscriber<OperatingState>;
template class Subscriber<StringStamped>;
template class Subscriber<Joy>;
template class Subscriber<Image>;
template class Subscriber<CompressedImage>;
template class Subscriber<CameraInfo>;
template class Subscriber<Text>;
template class Subscriber<Flag>;
template class Subscriber<Signal>;
template class Subscriber<WrenchStamped>;
template class Subscriber<CartesianState>;
template class Subscriber<Number>;
template class Subscriber<Matrix>;
template class Service<ForwardKinematicsQuery, ForwardKinematicsAnswer>;
template class Service<InverseKinematicsQuery, InverseKinematicsAnswer>;

}  // namespace dfr::dds
