#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace dfr::dds {

/// What a participant of a secured network may publish. All may subscribe to everything.
enum class Permission {
  kController,  ///< Commands, and everything else but what consoles measure.
  kConsole,     ///< Measurements, and everything else but commands and emergency stops.
  kButton,      ///< Emergency stops, nothing else.
  kMonitor,     ///< Nothing.
};

[[nodiscard]] const char* Name(Permission permission) noexcept;
/// The reverse. @throws std::invalid_argument naming the permissions there are.
[[nodiscard]] Permission ParsePermission(std::string_view name);

/// Options for MakeAuthority() and AddParticipant().
struct CertificateOptions {
  int days = 1095;  ///< From today until they expire, >= 1. The authority's own: ten years longer.
};

/// Makes the authority of a lab in a new folder, laid out as a keystore of ROS 2:
///
///   public/ca.cert.pem          the authority's certificate, for everybody
///   private/ca.key.pem          its key: whoever has it can admit participants. Keep it off the
///   robot. enclaves/governance.p7s     what is encrypted (everything), signed enclaves/NAME/ one
///   folder for each participant: SecurityFiles
///
/// Keys are readable for their user alone.
/// @throws std::invalid_argument if an option is out of range; std::runtime_error naming the file
///   if it exists, or cannot be written.
void MakeAuthority(const std::filesystem::path& folder, const CertificateOptions& options = {});

/// Adds a participant: its key, certificate and signed permissions. They stay valid for
/// `options.days`, or until the authority's own certificate ends.
/// @param name  letters, digits, '_', '-' and '.'.
/// @throws as MakeAuthority(), and if the participant exists, there is no authority in `folder`, or
///   others can read its key.
void AddParticipant(const std::filesystem::path& folder, const std::string& name,
                    Permission permission, const CertificateOptions& options = {});

}  // namespace dfr::dds
