#pragma once

#include <ctime>
#include <filesystem>
#include <string>

namespace dfr::dds {

/// Folder of one participant in a secured network (DDS Security 1.1: PKI-DH, access permissions,
/// AES-GCM). The file names are those of a ROS 2 enclave, which can be used directly:
///
///   identity_ca.cert.pem     authority that signs certificates
///   cert.pem, key.pem        identity of this participant; only its user may read the key
///   permissions_ca.cert.pem  authority that signs the next two files
///   governance.p7s           encryption rules, the same for all participants
///   permissions.p7s          topics this participant may publish and subscribe to
///
/// AddParticipant() creates such folders.
struct SecurityFiles {
  explicit SecurityFiles(const std::filesystem::path& folder);

  std::filesystem::path identity_ca;
  std::filesystem::path certificate;
  std::filesystem::path key;
  std::filesystem::path permissions_ca;
  std::filesystem::path governance;
  std::filesystem::path permissions;
};

/// Checks a participant's folder, because DDS itself reports a refusal without a reason. Detects a
/// missing file; a key that does not match the certificate or is readable by others; a folder or
/// file that others can change; and a certificate or permissions that another authority signed,
/// that are expired or not yet valid, or that belong to another participant.
/// @return the participant's name from its certificate.
/// @param now  time at which all files must be valid.
/// @throws std::runtime_error naming the file, its defect and the remedy.
std::string CheckSecurity(const std::filesystem::path& folder,
                          std::time_t now = std::time(nullptr));

}  // namespace dfr::dds
