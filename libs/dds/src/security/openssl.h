#pragma once

#include <openssl/bio.h>
#include <openssl/evp.h>
#include <openssl/pkcs7.h>
#include <openssl/x509.h>

#include <filesystem>
#include <memory>
#include <string>

namespace dfr::dds::internal {

/// Frees each OpenSSL object with the function for its type.
struct Deleter {
  void operator()(BIO* bio) const { BIO_free_all(bio); }
  void operator()(EVP_PKEY* key) const { EVP_PKEY_free(key); }
  void operator()(X509* certificate) const { X509_free(certificate); }
  void operator()(X509_STORE* store) const { X509_STORE_free(store); }
  void operator()(X509_STORE_CTX* context) const { X509_STORE_CTX_free(context); }
  void operator()(PKCS7* signature) const { PKCS7_free(signature); }
  void operator()(ASN1_TIME* time) const { ASN1_TIME_free(time); }
};
template <typename T>
using Owned = std::unique_ptr<T, Deleter>;

/// Returns the oldest pending error of OpenSSL, and clears all pending errors.
[[nodiscard]] std::string Complaint();

/// @throws std::runtime_error naming the file and the remedy.
[[nodiscard]] Owned<X509> LoadCertificate(const std::filesystem::path& file);
[[nodiscard]] Owned<EVP_PKEY> LoadKey(const std::filesystem::path& file);

/// Returns the common name of the subject.
[[nodiscard]] std::string CommonName(const X509& certificate);

/// Formats a time as a UTC date, "2026-11-21T00:00:00", as in permissions files.
[[nodiscard]] std::string Timestamp(const ASN1_TIME& time);

/// @throws core::Error if users other than the owner can read or change a key file.
void CheckPrivate(const std::filesystem::path& key);
/// @throws core::Error if users other than the owner can change a file or folder. Missing paths are
///   accepted.
void CheckUnchangeable(const std::filesystem::path& path);

}  // namespace dfr::dds::internal
