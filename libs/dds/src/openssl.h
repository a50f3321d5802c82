#pragma once

#include <openssl/bio.h>
#include <openssl/evp.h>
#include <openssl/pkcs7.h>
#include <openssl/x509.h>

#include <filesystem>
#include <memory>
#include <string>

namespace dfr::dds::internal {

/// OpenSSL's objects, freed by their own functions.
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

/// What OpenSSL last complained of, and forgets it.
[[nodiscard]] std::string Complaint();

/// @throws std::runtime_error naming the file and the remedy.
[[nodiscard]] Owned<X509> LoadCertificate(const std::filesystem::path& file);
[[nodiscard]] Owned<EVP_PKEY> LoadKey(const std::filesystem::path& file);

/// The common name of its subject.
[[nodiscard]] std::string CommonName(const X509& certificate);

/// A day of the calendar in UTC, "2026-11-21T00:00:00", as permissions have it.
[[nodiscard]] std::string Timestamp(const ASN1_TIME& time);

/// @throws core::Error if others than its user can read or change the file of a key.
void CheckPrivate(const std::filesystem::path& key);
/// @throws core::Error if others than its user can change a file or folder; what does not exist is
///   fine.
void CheckUnchangeable(const std::filesystem::path& path);

}  // namespace dfr::dds::internal
