#include "dfr/dds/security.h"

#include <openssl/pem.h>
#include <openssl/x509_vfy.h>

#include <iterator>
#include <stdexcept>

#include "dfr/core/error.h"
#include "security/openssl.h"

namespace dfr::dds {
namespace {

using internal::Owned;

constexpr const char* kRemake = "`hardware certificates` makes a new one";

[[noreturn]] void Wrong(const std::filesystem::path& file, const std::string& what,
                        const std::string& remedy = {}) {
  throw core::Error(file.string() + " " + what, remedy);
}

void CheckCertificate(const std::filesystem::path& file, X509& certificate,
                      const std::filesystem::path& ca_file, X509& ca, std::time_t now) {
  const Owned<X509_STORE> store(X509_STORE_new());
  const Owned<X509_STORE_CTX> context(X509_STORE_CTX_new());
  if (store == nullptr || context == nullptr || X509_STORE_add_cert(store.get(), &ca) != 1 ||
      X509_STORE_CTX_init(context.get(), store.get(), &certificate, nullptr) != 1) {
    throw std::runtime_error("OpenSSL failed: " + internal::Complaint());
  }
  X509_STORE_CTX_set_time(context.get(), 0, now);
  if (X509_verify_cert(context.get()) == 1) return;
  const int error = X509_STORE_CTX_get_error(context.get());
  const std::filesystem::path& which =
      X509_STORE_CTX_get_error_depth(context.get()) == 0 ? file : ca_file;
  const X509& dated = which == file ? certificate : ca;
  switch (error) {
    case X509_V_ERR_CERT_HAS_EXPIRED:
      Wrong(which, "expired on " + internal::Timestamp(*X509_get0_notAfter(&dated)),
            std::string(kRemake) + ", or correct this machine's clock");
    case X509_V_ERR_CERT_NOT_YET_VALID:
      Wrong(which, "is not valid before " + internal::Timestamp(*X509_get0_notBefore(&dated)) +
                       ": correct this machine's clock");
    default:
      Wrong(file, "was not signed by the authority '" + internal::CommonName(ca) + "' of " +
                      ca_file.string() + " (" + X509_verify_cert_error_string(error) +
                      "): take all files from one folder of `hardware certificates`");
  }
}

// Verifies a signed file and returns the document.
std::string CheckSigned(const std::filesystem::path& file, const std::filesystem::path& ca_file,
                        X509& ca) {
  const Owned<BIO> in(BIO_new_file(file.c_str(), "r"));
  if (in == nullptr) Wrong(file, std::string("cannot be read: ") + kRemake);
  BIO* content = nullptr;
  const Owned<PKCS7> signature(SMIME_read_PKCS7(in.get(), &content));
  const Owned<BIO> owned_content(content);
  if (signature == nullptr) {
    Wrong(file, "is not a signed document (S/MIME): " + internal::Complaint());
  }
  const Owned<X509_STORE> store(X509_STORE_new());
  const Owned<BIO> out(BIO_new(BIO_s_mem()));
  STACK_OF(X509)* signers = sk_X509_new_null();
  sk_X509_push(signers, &ca);
  const int good = PKCS7_verify(signature.get(), signers, store.get(), content, out.get(),
                                PKCS7_TEXT | PKCS7_NOVERIFY | PKCS7_NOINTERN);
  sk_X509_free(signers);
  if (good != 1) {
    static_cast<void>(internal::Complaint());
    Wrong(file,
          "was changed after it was signed, or signed by an authority other than '" +
              internal::CommonName(ca) + "' of " + ca_file.string(),
          kRemake);
  }
  char* data = nullptr;
  const auto size = BIO_get_mem_data(out.get(), &data);
  return {data, static_cast<std::size_t>(size)};
}

// Returns the text of the first element `name`; empty if there is none.
std::string Element(const std::string& document, const std::string& name) {
  const std::size_t tag = document.find("<" + name + ">");
  if (tag == std::string::npos) return {};
  const std::size_t begin = tag + name.size() + 2;
  const std::size_t end = document.find("</" + name + ">", begin);
  return end == std::string::npos ? std::string() : document.substr(begin, end - begin);
}

std::string TimestampAt(std::time_t time) {
  const Owned<ASN1_TIME> owned(ASN1_TIME_set(nullptr, time));
  if (owned == nullptr) throw std::runtime_error("OpenSSL failed: " + internal::Complaint());
  return internal::Timestamp(*owned);
}

}  // namespace

SecurityFiles::SecurityFiles(const std::filesystem::path& folder)
    : identity_ca(folder / "identity_ca.cert.pem"),
      certificate(folder / "cert.pem"),
      key(folder / "key.pem"),
      permissions_ca(folder / "permissions_ca.cert.pem"),
      governance(folder / "governance.p7s"),
      permissions(folder / "permissions.p7s") {}

std::string CheckSecurity(const std::filesystem::path& folder, std::time_t now) {
  if (!std::filesystem::is_directory(folder)) {
    Wrong(folder,
          "is not a folder: `hardware certificates` makes one for each participant, below "
          "enclaves/");
  }
  const SecurityFiles files(folder);
  const Owned<X509> identity_ca = internal::LoadCertificate(files.identity_ca);
  const Owned<X509> certificate = internal::LoadCertificate(files.certificate);
  const Owned<EVP_PKEY> key = internal::LoadKey(files.key);
  internal::CheckPrivate(files.key);
  // A user who can replace the authority's certificate controls which participants this process
  // trusts.
  internal::CheckUnchangeable(folder);
  for (const auto& file : {files.identity_ca, files.certificate, files.permissions_ca,
                           files.governance, files.permissions}) {
    internal::CheckUnchangeable(file);
  }
  if (X509_check_private_key(certificate.get(), key.get()) != 1) {
    static_cast<void>(internal::Complaint());
    Wrong(files.key, "is not the key of " + files.certificate.string() +
                         ": take both from the same folder of `hardware certificates`");
  }
  CheckCertificate(files.certificate, *certificate, files.identity_ca, *identity_ca, now);
  const Owned<X509> permissions_ca = internal::LoadCertificate(files.permissions_ca);
  CheckSigned(files.governance, files.permissions_ca, *permissions_ca);
  const std::string permissions =
      CheckSigned(files.permissions, files.permissions_ca, *permissions_ca);
  std::string name = internal::CommonName(*certificate);
  if (permissions.find("CN=" + name + "<") == std::string::npos) {
    Wrong(files.permissions, "belongs to '" + Element(permissions, "subject_name") + "', but " +
                                 files.certificate.string() + " belongs to 'CN=" + name +
                                 "': take both from the same folder of `hardware certificates`");
  }
  // Dates in this format have the same order as their strings.
  const std::string until = Element(permissions, "not_after");
  if (!until.empty() && until < TimestampAt(now)) {
    Wrong(files.permissions, "expired on " + until, kRemake);
  }
  return name;
}

}  // namespace dfr::dds
