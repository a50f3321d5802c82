#include "security/openssl.h"

#include <openssl/err.h>
#include <openssl/pem.h>

#include <array>
#include <ctime>
#include <stdexcept>

#include "dfr/core/error.h"

namespace dfr::dds::internal {
namespace {

Owned<BIO> Open(const std::filesystem::path& file) {
  Owned<BIO> bio(BIO_new_file(file.c_str(), "r"));
  if (bio == nullptr) {
    ERR_clear_error();
    throw std::runtime_error(
        "cannot read " + file.string() +
        ": `hardware certificates` creates it; this program's user must be able to read it");
  }
  return bio;
}

// Rejects keys with a passphrase, which a program that starts unattended cannot enter.
int NoPassphrase(char* /*buffer*/, int /*size*/, int /*writing*/, void* /*data*/) { return -1; }

}  // namespace

std::string Complaint() {
  std::array<char, 256> text{};
  ERR_error_string_n(ERR_get_error(), text.data(), text.size());
  ERR_clear_error();
  return text.data();
}

Owned<X509> LoadCertificate(const std::filesystem::path& file) {
  const Owned<BIO> bio = Open(file);
  Owned<X509> certificate(PEM_read_bio_X509(bio.get(), nullptr, nullptr, nullptr));
  if (certificate == nullptr) {
    throw std::runtime_error(file.string() + " is not a certificate in PEM: " + Complaint());
  }
  return certificate;
}

Owned<EVP_PKEY> LoadKey(const std::filesystem::path& file) {
  const Owned<BIO> bio = Open(file);
  Owned<EVP_PKEY> key(PEM_read_bio_PrivateKey(bio.get(), nullptr, NoPassphrase, nullptr));
  if (key == nullptr) {
    throw std::runtime_error(file.string() +
                             " is not a private key in PEM without a passphrase: " + Complaint());
  }
  return key;
}

std::string CommonName(const X509& certificate) {
  std::array<char, 256> text{};
  const int size = X509_NAME_get_text_by_NID(X509_get_subject_name(&certificate), NID_commonName,
                                             text.data(), static_cast<int>(text.size()));
  return size < 0 ? std::string() : std::string(text.data());
}

std::string Timestamp(const ASN1_TIME& time) {
  std::tm parts{};
  ASN1_TIME_to_tm(&time, &parts);
  std::array<char, 32> text{};
  std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%S", &parts);
  return text.data();
}

namespace {

bool Has(const std::filesystem::path& path, std::filesystem::perms any) {
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::status(path, error);
  return std::filesystem::exists(status) &&
         (status.permissions() & any) != std::filesystem::perms::none;
}

}  // namespace

void CheckPrivate(const std::filesystem::path& key) {
  using std::filesystem::perms;
  if (Has(key, perms::group_all | perms::others_all)) {
    throw core::Error(key.string() + " can be read by others: chmod 600 " + key.string(), "");
  }
}

void CheckUnchangeable(const std::filesystem::path& path) {
  using std::filesystem::perms;
  if (Has(path, perms::group_write | perms::others_write)) {
    throw core::Error(path.string() + " can be changed by others: chmod go-w " + path.string(), "");
  }
}

}  // namespace dfr::dds::internal
