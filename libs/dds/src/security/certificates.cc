#include "dfr/dds/certificates.h"

#include <fcntl.h>
#include <openssl/ec.h>
#include <openssl/pem.h>
#include <openssl/rand.h>
#include <openssl/x509v3.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <stdexcept>

#include "dfr/core/contract.h"
#include "dfr/core/text/suggest.h"
#include "dfr/dds/security.h"
#include "security/openssl.h"

namespace dfr::dds {
namespace {

using internal::Owned;

constexpr int kAuthorityDays = 3650;  // in addition to CertificateOptions::days

constexpr std::array kPermissions = {Permission::kController, Permission::kConsole,
                                     Permission::kButton, Permission::kMonitor};

// Authenticates, authorises and encrypts everything, including discovery and liveliness, and signs
// submessages without data (acknowledgements, gaps). ROS 2 keystores use the same rules.
constexpr std::string_view kGovernance =
    R"(<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_governance.xsd">
  <domain_access_rules>
    <domain_rule>
      <domains><id_range><min>0</min><max>232</max></id_range></domains>
      <allow_unauthenticated_participants>false</allow_unauthenticated_participants>
      <enable_join_access_control>true</enable_join_access_control>
      <discovery_protection_kind>ENCRYPT</discovery_protection_kind>
      <liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
      <rtps_protection_kind>SIGN</rtps_protection_kind>
      <topic_access_rules>
        <topic_rule>
          <topic_expression>*</topic_expression>
          <enable_discovery_protection>true</enable_discovery_protection>
          <enable_liveliness_protection>true</enable_liveliness_protection>
          <enable_read_access_control>true</enable_read_access_control>
          <enable_write_access_control>true</enable_write_access_control>
          <metadata_protection_kind>ENCRYPT</metadata_protection_kind>
          <data_protection_kind>ENCRYPT</data_protection_kind>
        </topic_rule>
      </topic_access_rules>
    </domain_rule>
  </domain_access_rules>
</dds>
)";

// Topics that command an arm, and topics on which an arm reports (CRTK). '*' also matches slashes.
// Emergency stops are commands because a console must not publish them.
constexpr std::array<std::string_view, 12> kCommands = {
    "rt/*servo_*",        "rt/*move_*",           "rt/*/hold",           "rt/*/free",
    "rt/*/state_command", "rt/simulator/request", "rt/*emergency_stop*", "rt/*interpolate_*",
    "rt/*/set_*",         "rt/*/use_*",           "rt/*/emulate_*",      "rq/*"};
constexpr std::array<std::string_view, 12> kMeasurements = {
    "rt/*measured_*",     "rt/*setpoint_*", "rt/*/operating_state", "rt/*/goal_reached",
    "rt/*/error",         "rt/*/warning",   "rt/*/image_raw*",      "rt/*/camera_info",
    "rt/simulator/reply", "rt/*/tool_type", "rt/*jacobian",         "rr/*"};
constexpr std::array<std::string_view, 1> kButtons = {"rt/*emergency_stop*"};
constexpr std::array<std::string_view, 1> kEverything = {"*"};

// Creates a file; never replaces an existing one.
void Write(const std::filesystem::path& path, std::string_view content, mode_t mode) {
  const int file = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, mode);
  int error = file < 0 ? errno : 0;
  while (error == 0 && !content.empty()) {
    const ssize_t written = ::write(file, content.data(), content.size());
    if (written >= 0) {
      content.remove_prefix(static_cast<std::size_t>(written));
    } else if (errno != EINTR) {
      error = errno;
    }
  }
  if (file >= 0 && ::close(file) != 0 && error == 0) error = errno;
  if (error != 0) {
    throw std::runtime_error("cannot write " + path.string() + ": " + std::strerror(error));
  }
}

void MakeFolder(const std::filesystem::path& path, std::filesystem::perms mode) {
  std::filesystem::create_directories(path);
  std::filesystem::permissions(path, mode);
}

std::string Content(BIO& memory) {
  char* data = nullptr;
  const auto size = BIO_get_mem_data(&memory, &data);
  return {data, static_cast<std::size_t>(size)};
}

// Checks for internal failures of OpenSSL (memory, random numbers), which no caller can avoid.
void Require(bool good) {
  if (!good) throw std::runtime_error("OpenSSL failed: " + internal::Complaint());
}

std::string Pem(const X509& certificate) {
  const Owned<BIO> memory(BIO_new(BIO_s_mem()));
  Require(memory != nullptr && PEM_write_bio_X509(memory.get(), &certificate) == 1);
  return Content(*memory);
}

std::string Pem(const EVP_PKEY& key) {
  const Owned<BIO> memory(BIO_new(BIO_s_secmem()));
  Require(memory != nullptr && PEM_write_bio_PKCS8PrivateKey(memory.get(), &key, nullptr, nullptr,
                                                             0, nullptr, nullptr) == 1);
  return Content(*memory);
}

void AddExtension(X509& certificate, X509& issuer, int id, const char* value) {
  X509V3_CTX context;
  X509V3_set_ctx(&context, &issuer, &certificate, nullptr, nullptr, 0);
  X509_EXTENSION* extension = X509V3_EXT_conf_nid(nullptr, &context, id, value);
  Require(extension != nullptr && X509_add_ext(&certificate, extension, -1) == 1);
  X509_EXTENSION_free(extension);
}

// Creates a certificate for `name` and `key`, signed by `issuer`, or self-signed if `issuer` is
// nullptr.
Owned<X509> Certify(const std::string& name, EVP_PKEY& key, int days, X509* issuer,
                    EVP_PKEY& issuer_key) {
  Owned<X509> certificate(X509_new());
  Require(certificate != nullptr);
  X509_set_version(certificate.get(), X509_VERSION_3);
  std::array<unsigned char, 16> serial{};
  Require(RAND_bytes(serial.data(), serial.size()) == 1);
  serial[0] &= 0x7f;  // positive
  BIGNUM* number = BN_bin2bn(serial.data(), serial.size(), nullptr);
  const bool numbered =
      BN_to_ASN1_INTEGER(number, X509_get_serialNumber(certificate.get())) != nullptr;
  BN_free(number);
  Require(numbered);
  X509_NAME* subject = X509_get_subject_name(certificate.get());
  Require(X509_NAME_add_entry_by_txt(subject, "CN", MBSTRING_UTF8,
                                     reinterpret_cast<const unsigned char*>(name.c_str()), -1, -1,
                                     0) == 1);
  X509& by = issuer == nullptr ? *certificate : *issuer;
  Require(X509_set_issuer_name(certificate.get(), X509_get_subject_name(&by)) == 1);
  // Tolerates clocks of other machines that are up to a day behind.
  X509_gmtime_adj(X509_getm_notBefore(certificate.get()), -86400);
  Require(X509_time_adj_ex(X509_getm_notAfter(certificate.get()), days, 0, nullptr) != nullptr);
  if (issuer != nullptr &&
      ASN1_TIME_compare(X509_get0_notAfter(certificate.get()), X509_get0_notAfter(issuer)) > 0) {
    Require(X509_set1_notAfter(certificate.get(), X509_get0_notAfter(issuer)) == 1);
  }
  Require(X509_set_pubkey(certificate.get(), &key) == 1);
  AddExtension(*certificate, by, NID_basic_constraints,
               issuer == nullptr ? "critical,CA:TRUE" : "critical,CA:FALSE");
  AddExtension(*certificate, by, NID_key_usage,
               issuer == nullptr ? "critical,keyCertSign,cRLSign,digitalSignature"
                                 : "critical,digitalSignature,keyAgreement");
  AddExtension(*certificate, by, NID_subject_key_identifier, "hash");
  if (issuer != nullptr) {
    AddExtension(*certificate, by, NID_authority_key_identifier, "keyid:always");
  }
  Require(X509_sign(certificate.get(), &issuer_key, EVP_sha256()) > 0);
  return certificate;
}

Owned<EVP_PKEY> MakeKey() {
  Owned<EVP_PKEY> key(EVP_EC_gen("P-256"));
  Require(key != nullptr);
  return key;
}

// Returns S/MIME text with a detached signature and a text header, as DDS Security requires.
std::string Sign(std::string_view document, X509& certificate, EVP_PKEY& key) {
  constexpr int kFlags = PKCS7_TEXT | PKCS7_DETACHED | PKCS7_STREAM;
  const Owned<BIO> in(BIO_new_mem_buf(document.data(), static_cast<int>(document.size())));
  const Owned<BIO> out(BIO_new(BIO_s_mem()));
  Require(in != nullptr && out != nullptr);
  const Owned<PKCS7> signature(PKCS7_sign(&certificate, &key, nullptr, in.get(), kFlags));
  Require(signature != nullptr &&
          SMIME_write_PKCS7(out.get(), signature.get(), in.get(), kFlags) == 1);
  return Content(*out);
}

template <typename Topics>
std::string Rule(const char* rule, const char* verb, const Topics& topics) {
  std::string text = std::string("      <") + rule +
                     ">\n        <domains><id_range><min>0</min><max>232</max></id_range>"
                     "</domains>\n        <" +
                     verb + ">\n          <topics>\n";
  for (const std::string_view topic : topics) {
    text += "            <topic>" + std::string(topic) + "</topic>\n";
  }
  return text + "          </topics>\n        </" + verb + ">\n      </" + rule + ">\n";
}

// The first rule that matches a topic applies.
std::string Permissions(const std::string& name, Permission permission, const X509& certificate) {
  std::string rules;
  switch (permission) {
    case Permission::kController:
      rules =
          Rule("deny_rule", "publish", kMeasurements) + Rule("allow_rule", "publish", kEverything);
      break;
    case Permission::kConsole:
      rules = Rule("deny_rule", "publish", kCommands) + Rule("allow_rule", "publish", kEverything);
      break;
    case Permission::kButton:
      rules = Rule("allow_rule", "publish", kButtons);
      break;
    case Permission::kMonitor:
      break;
  }
  rules += Rule("allow_rule", "subscribe", kEverything);
  return R"(<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_permissions.xsd">
  <permissions>
    <grant name=")" +
         name + "\">\n      <subject_name>CN=" + name + "</subject_name>\n      <validity>" +
         "<not_before>" + internal::Timestamp(*X509_get0_notBefore(&certificate)) +
         "</not_before><not_after>" + internal::Timestamp(*X509_get0_notAfter(&certificate)) +
         "</not_after></validity>\n" + rules +
         "      <default>DENY</default>\n    </grant>\n  </permissions>\n</dds>\n";
}

std::filesystem::path AuthorityCertificate(const std::filesystem::path& folder) {
  return folder / "public" / "ca.cert.pem";
}
std::filesystem::path AuthorityKey(const std::filesystem::path& folder) {
  return folder / "private" / "ca.key.pem";
}

void Check(const CertificateOptions& options) {
  DFR_THROW_UNLESS(options.days >= 1 && options.days <= 36500,
                   "days must lie in [1, 36500], not " << options.days);
}

}  // namespace

const char* Name(Permission permission) noexcept {
  switch (permission) {
    case Permission::kController:
      return "controller";
    case Permission::kConsole:
      return "console";
    case Permission::kButton:
      return "button";
    case Permission::kMonitor:
      return "monitor";
  }
  return "unknown";
}

Permission ParsePermission(std::string_view name) {
  for (const Permission permission : kPermissions) {
    if (name == Name(permission)) return permission;
  }
  throw core::UnknownName("permission", name, "controller, console, button or monitor");
}

void MakeAuthority(const std::filesystem::path& folder, const CertificateOptions& options) {
  Check(options);
  if (std::filesystem::exists(AuthorityKey(folder))) {
    throw std::runtime_error(folder.string() +
                             " already has an authority: add participants to it, or choose "
                             "another folder");
  }
  const Owned<EVP_PKEY> key = MakeKey();
  // A random suffix of the name distinguishes the certificates of two authorities.
  std::array<unsigned char, 4> mark{};
  Require(RAND_bytes(mark.data(), mark.size()) == 1);
  std::string name = "dfr authority ";
  for (const unsigned char byte : mark) {
    name += "0123456789abcdef"[byte >> 4U];
    name += "0123456789abcdef"[byte & 15U];
  }
  const Owned<X509> certificate = Certify(name, *key, options.days + kAuthorityDays, nullptr, *key);
  constexpr auto kAll = std::filesystem::perms(0755);
  MakeFolder(folder / "public", kAll);
  MakeFolder(folder / "private", std::filesystem::perms::owner_all);
  MakeFolder(folder / "enclaves", kAll);
  Write(AuthorityKey(folder), Pem(*key), 0600);
  Write(AuthorityCertificate(folder), Pem(*certificate), 0644);
  Write(folder / "enclaves" / "governance.xml", kGovernance, 0644);
  Write(folder / "enclaves" / "governance.p7s", Sign(kGovernance, *certificate, *key), 0644);
}

void CheckParticipantName(const std::string& name) {
  const bool spelled = !name.empty() && name.front() != '.' && name.size() <= 64 &&
                       std::all_of(name.begin(), name.end(), [](char c) {
                         return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
                                (c >= '0' && c <= '9') || c == '_' || c == '-' || c == '.';
                       });
  DFR_THROW_UNLESS(spelled,
                   "a participant's name must have 1 to 64 letters, digits, '_', '-' and '.', "
                   "and must not begin with '.': not '"
                       << name << "'");
}

void AddParticipant(const std::filesystem::path& folder, const std::string& name,
                    Permission permission, const CertificateOptions& options) {
  Check(options);
  CheckParticipantName(name);
  const std::filesystem::path own = folder / "enclaves" / name;
  if (std::filesystem::exists(own)) {
    throw std::runtime_error("participant '" + name + "' already exists: remove " + own.string() +
                             " to create it again");
  }
  internal::CheckPrivate(AuthorityKey(folder));
  internal::CheckUnchangeable(AuthorityKey(folder).parent_path());
  const Owned<X509> authority = internal::LoadCertificate(AuthorityCertificate(folder));
  const Owned<EVP_PKEY> authority_key = internal::LoadKey(AuthorityKey(folder));
  const Owned<EVP_PKEY> key = MakeKey();
  const Owned<X509> certificate =
      Certify(name, *key, options.days, authority.get(), *authority_key);
  const std::string permissions = Permissions(name, permission, *certificate);
  const SecurityFiles files(own);
  MakeFolder(own, std::filesystem::perms::owner_all);
  Write(files.key, Pem(*key), 0600);
  Write(files.certificate, Pem(*certificate), 0644);
  Write(own / "permissions.xml", permissions, 0644);
  Write(files.permissions, Sign(permissions, *authority, *authority_key), 0644);
  // Copies instead of links, because the participant's folder moves to another machine.
  std::filesystem::copy_file(AuthorityCertificate(folder), files.identity_ca);
  std::filesystem::copy_file(AuthorityCertificate(folder), files.permissions_ca);
  std::filesystem::copy_file(folder / "enclaves" / "governance.p7s", files.governance);
}

}  // namespace dfr::dds
