#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace dfr::dds {

/// Publication rights of a participant in a secured network. Every participant may subscribe to all
/// topics.
enum class Permission {
  kController,  ///< Everything, including commands, except console measurements.
  kConsole,     ///< Everything, including measurements, except commands and emergency stops.
  kButton,      ///< Emergency stops only.
  kMonitor,     ///< Nothing.
};

[[nodiscard]] const char* Name(Permission permission) noexcept;
/// Inverse of Name(). @throws std::invalid_argument listing the valid names.
[[nodiscard]] Permission ParsePermission(std::string_view name);

/// Options for MakeAuthority() and AddParticipant().
struct CertificateOptions {
  int days = 1095;  ///< Validity from today, in [1, 36500]. The authority's lasts ten years longer.
};

/// Creates the certificate authority of a lab in a new folder, laid out as a ROS 2 keystore:
///
///   public/ca.cert.pem          certificate of the authority, for everyone
///   private/ca.key.pem          its key, which signs other certificates; keep it off the robot
///   enclaves/governance.p7s     signed encryption rules (everything is encrypted)
///   enclaves/NAME/              one folder per participant, see SecurityFiles
///
/// Only the user who runs the program can read the keys.
/// @throws std::invalid_argument if an option is out of range; std::runtime_error naming `folder`
///   if it already has an authority, or naming a file that cannot be written.
void MakeAuthority(const std::filesystem::path& folder, const CertificateOptions& options = {});

/// @throws std::invalid_argument unless `name` has 1 to 64 letters, digits, '_', '-' and '.', and
///   does not begin with '.'.
void CheckParticipantName(const std::string& name);

/// Adds a participant: creates its key, certificate and signed permissions. They are valid for
/// `options.days`, but not beyond the authority's certificate.
/// @throws as MakeAuthority() and CheckParticipantName(), and if the participant exists, `folder`
///   has no authority, or users other than the owner can read the authority's key.
void AddParticipant(const std::filesystem::path& folder, const std::string& name,
                    Permission permission, const CertificateOptions& options = {});

}  // namespace dfr::dds
