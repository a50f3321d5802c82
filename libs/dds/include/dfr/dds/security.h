#pragma once

#include <ctime>
#include <filesystem>
#include <string>

namespace dfr::dds {

/// The folder of one participant in a secured network (DDS Security 1.1: PKI-DH, access
/// permissions, AES-GCM), with the names that ROS 2's enclaves have, so that one of those will do:
///
///   identity_ca.cert.pem     who signs certificates
///   cert.pem, key.pem        who this participant is; the key belongs to its user alone
///   permissions_ca.cert.pem  who signs the next two
///   governance.p7s           what is encrypted, the same for all participants
///   permissions.p7s          what this participant may publish and subscribe to
///
/// AddParticipant() makes such folders.
struct SecurityFiles {
  explicit SecurityFiles(const std::filesystem::path& folder);

  std::filesystem::path identity_ca;
  std::filesystem::path certificate;
  std::filesystem::path key;
  std::filesystem::path permissions_ca;
  std::filesystem::path governance;
  std::filesystem::path permissions;
};

/// Checks all that can be wrong with a participant's folder, for DDS itself says just that it
/// refuses: a file is missing, the key is not the certificate's or can be read by others, others
/// can change the folder or a file in it, a certificate or the permissions are of another
/// authority, expired, not valid yet, or made for another participant.
/// @return the participant's name, as its certificate has it.
/// @param now  when all that is in it has to be valid.
/// @throws std::runtime_error naming the file, what is wrong with it, and the remedy.
std::string CheckSecurity(const std::filesystem::path& folder,
                          std::time_t now = std::time(nullptr));

}  // namespace dfr::dds
