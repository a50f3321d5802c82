#pragma once

#include <dds/dds.h>

#include <cstdlib>
#include <string>

/// Code shared by independent programs with CycloneDDS. These programs share with dfr only names,
/// types and ROS 2's quality of service. Each program has one participant, and ends with code 1 if
/// DDS fails.
namespace dfr::test {

inline dds_entity_t participant;

inline dds_entity_t Check(dds_entity_t code) {
  if (code < 0) std::exit(EXIT_FAILURE);
  return code;
}

/// Creates the participant in a domain given as text.
inline void Join(const char* domain) {
  participant = Check(dds_create_participant(
      static_cast<dds_domainid_t>(std::strtoul(domain, nullptr, 10)), nullptr, nullptr));
}

/// Keeps the last `depth` samples, reliably. "latched" publishers keep them for late joiners.
inline dds_qos_t* Qos(int depth, bool latched) {
  dds_qos_t* qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, depth);
  dds_qset_durability(qos, latched ? DDS_DURABILITY_TRANSIENT_LOCAL : DDS_DURABILITY_VOLATILE);
  return qos;
}

inline dds_entity_t Topic(const dds_topic_descriptor_t& type, const std::string& full) {
  return Check(dds_create_topic(participant, &type, full.c_str(), nullptr, nullptr));
}

inline dds_entity_t MakeReader(const dds_topic_descriptor_t& type, const std::string& full,
                               int depth, bool latched = false) {
  dds_qos_t* qos = Qos(depth, latched);
  const dds_entity_t reader =
      Check(dds_create_reader(participant, Topic(type, full), qos, nullptr));
  dds_delete_qos(qos);
  return reader;
}

inline dds_entity_t MakeWriter(const dds_topic_descriptor_t& type, const std::string& full,
                               int depth, bool latched = false) {
  dds_qos_t* qos = Qos(depth, latched);
  const dds_entity_t writer =
      Check(dds_create_writer(participant, Topic(type, full), qos, nullptr));
  dds_delete_qos(qos);
  return writer;
}

/// Calls use(sample) if a sample is available.
template <typename T, typename Use>
bool Take(dds_entity_t reader, Use use) {
  void* sample = nullptr;
  dds_sample_info_t info;
  const dds_return_t count = Check(dds_take(reader, &sample, &info, 1, 1));
  const bool any = count > 0 && info.valid_data;
  if (any) use(*static_cast<T*>(sample));
  if (count > 0) dds_return_loan(reader, &sample, count);
  return any;
}

}  // namespace dfr::test
