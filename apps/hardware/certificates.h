#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "dfr/dds/certificates.h"

namespace dfr::apps::hardware_app {

struct CertificatesOptions {
  std::filesystem::path folder;
  /// NAME or NAME:PERMISSION each.
  std::vector<std::string> participants = {"line_tracking", "dvrk_simulator", "stop", "monitor"};
  dds::CertificateOptions certificates;
};

/// Makes a lab's authority, unless it is there, and certificates for the participants, and prints
/// what belongs where. @throws as dds::AddParticipant(); then nothing was made.
void RunCertificates(const CertificatesOptions& options);

}  // namespace dfr::apps::hardware_app
