#include "dfr/dds/certificates.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <cerrno>
#include <csignal>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string>

#include "dfr/dds/security.h"
#include "tests/dds/security/keystore.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::dds {
namespace {

using std::filesystem::path;
using std::filesystem::perms;
using testing::HasSubstr;

// Returns the error about a participant's folder.
std::string Complaint(const path& folder, std::time_t now = std::time(nullptr)) {
  return dfr::test::MessageOf<std::runtime_error>([&] { CheckSecurity(folder, now); });
}

void Replace(const path& file, const path& by) {
  std::filesystem::copy_file(by, file, std::filesystem::copy_options::overwrite_existing);
}

class CertificatesTest : public testing::Test {
 protected:
  const test::Keystore keystore_{{"client", Permission::kController},
                                 {"console", Permission::kConsole}};
  const path client_ = keystore_.enclave("client");
  const SecurityFiles files_{client_};
  const path ca_key_ = keystore_.folder() / "private" / "ca.key.pem";
};

TEST_F(CertificatesTest, OnlyTheOwnerCanReadKeys) {
  constexpr perms kMine = perms::owner_read | perms::owner_write;
  EXPECT_EQ(std::filesystem::status(files_.key).permissions(), kMine);
  EXPECT_EQ(std::filesystem::status(ca_key_).permissions(), kMine);
  EXPECT_EQ(std::filesystem::status(keystore_.folder() / "private").permissions(),
            perms::owner_all);
  std::filesystem::permissions(files_.key, perms::group_read, std::filesystem::perm_options::add);
  EXPECT_THAT(Complaint(client_), HasSubstr("key.pem can be read by others: chmod 600"));
}

TEST_F(CertificatesTest, FoldersAndFilesThatOthersCanChangeAreRefused) {
  using std::filesystem::perm_options;
  for (const std::filesystem::path& path :
       {client_, files_.identity_ca, files_.permissions_ca, files_.governance}) {
    for (const perms who : {perms::group_write, perms::others_write}) {
      std::filesystem::permissions(path, who, perm_options::add);
      EXPECT_THAT(Complaint(client_), HasSubstr(path.string() + " can be changed by others"));
      std::filesystem::permissions(path, who, perm_options::remove);
      EXPECT_EQ(Complaint(client_), "nothing thrown");
    }
  }
}

TEST_F(CertificatesTest, AnAuthorityWhoseKeyOthersCanReadAdmitsNoParticipant) {
  using std::filesystem::perm_options;
  std::filesystem::permissions(ca_key_, perms::others_read, perm_options::add);
  EXPECT_THAT(dfr::test::MessageOf<std::runtime_error>(
                  [&] { AddParticipant(keystore_.folder(), "late", Permission::kMonitor); }),
              HasSubstr("ca.key.pem can be read by others: chmod 600"));
  EXPECT_FALSE(std::filesystem::exists(keystore_.enclave("late")));
  std::filesystem::permissions(ca_key_, perms::others_read, perm_options::remove);
  EXPECT_NO_THROW(AddParticipant(keystore_.folder(), "late", Permission::kMonitor));
}

TEST_F(CertificatesTest, ExistingFilesAreNotOverwritten) {
  const std::string before = test::FileText(files_.key);
  EXPECT_THROW(MakeAuthority(keystore_.folder()), std::runtime_error);
  EXPECT_THROW(AddParticipant(keystore_.folder(), "client", Permission::kConsole),
               std::runtime_error);
  EXPECT_EQ(test::FileText(files_.key), before);
  // Adding a third participant leaves the first two valid.
  AddParticipant(keystore_.folder(), "monitor", Permission::kMonitor);
  for (const char* name : {"client", "console", "monitor"}) {
    EXPECT_EQ(CheckSecurity(keystore_.enclave(name)), name);
  }
}

TEST_F(CertificatesTest, EachMissingFileIsNamed) {
  EXPECT_THAT(Complaint(keystore_.enclave("nobody")), HasSubstr("nobody is not a folder"));
  for (const path& file : {files_.identity_ca, files_.certificate, files_.key,
                           files_.permissions_ca, files_.governance, files_.permissions}) {
    const path aside = file.string() + ".aside";
    std::filesystem::rename(file, aside);
    EXPECT_THAT(Complaint(client_), HasSubstr(file.string()));
    EXPECT_THAT(Complaint(client_), HasSubstr("hardware certificates"));
    std::ofstream(file) << "not what it should be\n";
    std::filesystem::permissions(file, perms::owner_read | perms::owner_write);
    EXPECT_THAT(Complaint(client_), HasSubstr(file.string() + " is not a"));
    std::filesystem::remove(file);
    std::filesystem::rename(aside, file);
  }
  EXPECT_EQ(Complaint(client_), "nothing thrown");
}

TEST_F(CertificatesTest, FilesOfTwoParticipantsDoNotMix) {
  const SecurityFiles console(keystore_.enclave("console"));
  Replace(files_.key, console.key);
  EXPECT_THAT(Complaint(client_), HasSubstr("key.pem is not the key of"));
  Replace(files_.certificate, console.certificate);
  EXPECT_THAT(Complaint(client_), HasSubstr("permissions.p7s belongs to 'CN=client', but"));
  Replace(files_.permissions, console.permissions);
  EXPECT_EQ(CheckSecurity(client_), "console");
}

// A limit on file sizes stands in for a full disk.
TEST_F(CertificatesTest, AFullDiskIsNamed) {
  rlimit unlimited{};
  getrlimit(RLIMIT_FSIZE, &unlimited);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{50, unlimited.rlim_max};
  setrlimit(RLIMIT_FSIZE, &small);
  errno = EEXIST;  // from an earlier call; must not be reported
  const std::string error = dfr::test::MessageOf<std::runtime_error>(
      [&] { AddParticipant(keystore_.folder(), "second", Permission::kController); });
  setrlimit(RLIMIT_FSIZE, &unlimited);
  std::signal(SIGXFSZ, handler);
  EXPECT_THAT(error, HasSubstr(std::strerror(EFBIG)));
}

TEST_F(CertificatesTest, AnotherAuthorityIsRefused) {
  const test::Keystore other({{"client", Permission::kController}});
  const SecurityFiles others(other.enclave("client"));
  Replace(files_.identity_ca, others.identity_ca);
  EXPECT_THAT(Complaint(client_),
              HasSubstr("cert.pem was not signed by the authority 'dfr authority"));
  Replace(files_.certificate, others.certificate);
  Replace(files_.key, others.key);
  EXPECT_EQ(Complaint(client_),
            "nothing thrown");  // identity and permissions may come from two authorities
  Replace(files_.permissions_ca, others.permissions_ca);
  EXPECT_THAT(Complaint(client_), HasSubstr("governance.p7s was changed after it was signed"));
}

// The permissions grant more rights than were signed.
TEST_F(CertificatesTest, ChangedPermissionsAreRefused) {
  std::string permissions = test::FileText(files_.permissions);
  const std::size_t rule = permissions.find("<deny_rule>");
  ASSERT_NE(rule, std::string::npos);
  permissions.replace(rule, 11, "<nota_rule>");
  std::ofstream(files_.permissions, std::ios::binary) << permissions;
  EXPECT_THAT(Complaint(client_), HasSubstr("permissions.p7s was changed after it was signed"));
}

TEST_F(CertificatesTest, ExpiredCertificatesAreRefused) {
  constexpr std::time_t kDay = 86'400;
  const std::time_t today = std::time(nullptr);
  EXPECT_EQ(Complaint(client_, today + 1000 * kDay), "nothing thrown");
  EXPECT_THAT(Complaint(client_, today + 1100 * kDay), HasSubstr("cert.pem expired on 20"));
  EXPECT_THAT(Complaint(client_, today - 2 * kDay), HasSubstr("cert.pem is not valid before 20"));
  // The permissions expire before the certificate.
  const path lasting = keystore_.folder() / "lasting";
  std::filesystem::rename(client_, lasting);
  AddParticipant(keystore_.folder(), "client", Permission::kController, {.days = 1});
  const SecurityFiles last(lasting);
  Replace(files_.certificate, last.certificate);
  Replace(files_.key, last.key);
  EXPECT_EQ(Complaint(client_, today), "nothing thrown");
  EXPECT_THAT(Complaint(client_, today + 2 * kDay), HasSubstr("permissions.p7s expired on 20"));
}

TEST_F(CertificatesTest, NamesAndOptionsOutOfRangeAreRefused) {
  for (const char* name : {"", "..", "a/b", "a b", ".hidden", "a<b"}) {
    EXPECT_THROW(AddParticipant(keystore_.folder(), name, Permission::kMonitor),
                 std::invalid_argument)
        << name;
  }
  EXPECT_THROW(AddParticipant(keystore_.folder(), "a", Permission::kMonitor, {.days = 0}),
               std::invalid_argument);
  EXPECT_THROW(AddParticipant(keystore_.folder() / "empty", "a", Permission::kMonitor),
               std::runtime_error);
  for (const Permission permission :
       {Permission::kController, Permission::kConsole, Permission::kButton, Permission::kMonitor}) {
    EXPECT_EQ(ParsePermission(Name(permission)), permission);
  }
  EXPECT_THROW(static_cast<void>(ParsePermission("root")), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::dds
