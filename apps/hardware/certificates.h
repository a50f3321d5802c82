#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "dfr/dds/certificates.h"

namespace dfr::apps::hardware_app {

struct CertificatesOptions {
  std::filesystem::path folder;
  /// Each participant is NAME or NAME:PERMISSION.
  std::vector<std::string> participants = {"line_tracking", "dvrk_simulator", "stop", "monitor"};
  dds::CertificateOptions certificates;
};

/// Creates a lab's authority unless it exists, and certificates for the participants. Prints the
/// folders to copy. @throws as dds::AddParticipant(), or if a permission is unknown.
void RunCertificates(const CertificatesOptions& options);

}  // namespace dfr::apps::hardware_app
