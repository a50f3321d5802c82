// Acceptance of the emergency stop's datagrams. Refused datagrams count as absent, which stops the
// robot.
#include "stop_datagrams.h"

#include <gtest/gtest.h>
#include <openssl/evp.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "dfr/core/random.h"
#include "dfr/dds/emergency_stop.h"
#include "dfr/dds/security.h"
#include "security/openssl.h"
#include "tests/dds/security/keystore.h"

namespace dfr::dds {
namespace {

using internal::StopReader;
using internal::StopSenderId;
using internal::StopWriter;

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kNow = 1'700'000'000 * kSecond;

// A reader's result for a datagram: none, or the state of the button.
std::optional<bool> Read(StopReader& reader, std::string_view datagram,
                         std::int64_t wall_ns = kNow) {
  StopSenderId who;
  bool pressed = false;
  if (!reader.Read(datagram, wall_ns, who, pressed)) return std::nullopt;
  return pressed;
}

class StopDatagramsTest : public testing::Test {
 protected:
  StopWriter writer_{{}};
  StopReader reader_{{}};
};

TEST_F(StopDatagramsTest, IdentifyTheSenderAndItsState) {
  StopWriter other({});
  StopSenderId one;
  StopSenderId two;
  bool pressed = true;
  ASSERT_TRUE(reader_.Read(writer_.Next(false, kNow), kNow, one, pressed));
  EXPECT_FALSE(pressed);
  ASSERT_TRUE(reader_.Read(other.Next(true, kNow), kNow, two, pressed));
  EXPECT_TRUE(pressed);
  EXPECT_NE(one, two);
  ASSERT_TRUE(reader_.Read(writer_.Next(true, kNow), kNow, two, pressed));
  EXPECT_EQ(one, two);
}

TEST_F(StopDatagramsTest, RepeatedDatagramsAreIgnored) {
  const std::string clear = writer_.Next(false, kNow);
  const std::string lost = writer_.Next(false, kNow);
  ASSERT_EQ(clear.size(), 43U);
  EXPECT_EQ(Read(reader_, clear), false);
  EXPECT_EQ(Read(reader_, clear), std::nullopt);
  EXPECT_EQ(Read(reader_, writer_.Next(true, kNow)), true);
  EXPECT_EQ(Read(reader_, lost), std::nullopt) << "older than the last one read";
}

TEST_F(StopDatagramsTest, OldDatagramsAreIgnored) {
  for (const std::int64_t astray_ns : {kSecond, -kSecond}) {
    EXPECT_EQ(Read(reader_, writer_.Next(false, kNow), kNow + astray_ns), false);
    const std::int64_t more_ns = astray_ns > 0 ? 1 : -1;
    EXPECT_FALSE(reader_.clocks_differ());
    EXPECT_EQ(Read(reader_, writer_.Next(false, kNow), kNow + astray_ns + more_ns), std::nullopt);
    EXPECT_TRUE(reader_.clocks_differ());
    EXPECT_EQ(Read(reader_, writer_.Next(false, kNow)), false);
    EXPECT_FALSE(reader_.clocks_differ());
  }
  EXPECT_EQ(Read(reader_, writer_.Next(false, kNow).substr(1), kNow + 9 * kSecond), std::nullopt);
  EXPECT_FALSE(reader_.clocks_differ()) << "not a stop's datagram";
}

// An old datagram is not evidence of a released button. It need not be evidence of a pressed
// button, because silence stops the robot.
TEST_F(StopDatagramsTest, ExcessiveNetworkDelayStops) {
  constexpr std::int64_t kLongestSilence = kSecond / 10;
  for (const bool pressed : {false, true}) {
    EmergencyStopJudge judge(1e-9 * kLongestSilence);
    StopReader reader({});
    EmergencyStop found = EmergencyStop::kSilent;
    std::int64_t heard_ns = 0;
    StopSenderId who{};
    // The button sends every 20 ms. Each datagram is delayed by 20 ms more than the previous one.
    for (std::int64_t sent_ns = 0; sent_ns < 2 * kSecond; sent_ns += kSecond / 50) {
      const std::int64_t now_ns = 2 * sent_ns;
      const bool late = now_ns - sent_ns > kSecond;
      const std::string datagram = writer_.Next(late && pressed, kNow + sent_ns);
      bool says_pressed = false;
      if (reader.Read(datagram, kNow + now_ns, who, says_pressed)) {
        judge.Hear(EmergencyStopJudge::Way::kDatagrams, who, says_pressed, now_ns);
        heard_ns = now_ns;
      }
      judge.Hear(EmergencyStopJudge::Way::kDds, who, false, now_ns);
      found = judge.Check(now_ns);
      // Datagrams are accepted up to a delay of one second. The silence after the last one stops
      // the robot.
      EXPECT_EQ(found, now_ns - heard_ns <= kLongestSilence ? EmergencyStop::kClear
                                                            : EmergencyStop::kSilent);
    }
    EXPECT_EQ(heard_ns, 2 * kSecond);
    EXPECT_EQ(found, EmergencyStop::kSilent);
  }
}

// Seeded random bytes, and valid datagrams that are truncated, extended or changed by a byte.
TEST_F(StopDatagramsTest, MalformedDatagramsAreIgnored) {
  core::Random random(1);
  for (int n = 0; n < 20'000; ++n) {
    std::string bytes(random.Below(200), '\0');
    for (char& byte : bytes) byte = static_cast<char>(random.Below(256));
    if (n % 2 == 0) bytes.replace(0, std::min<std::size_t>(8, bytes.size()), "dfrstop1", 8);
    ASSERT_EQ(Read(reader_, bytes), std::nullopt);
  }
  const std::string good = writer_.Next(false, kNow);
  EXPECT_EQ(Read(reader_, good + "x"), std::nullopt);
  for (std::size_t size = 0; size < good.size(); ++size) {
    EXPECT_EQ(Read(reader_, good.substr(0, size)), std::nullopt) << size;
  }
  std::string neither = good;
  neither[40] = 2;
  EXPECT_EQ(Read(reader_, neither), std::nullopt) << "neither pressed nor not";
  EXPECT_EQ(Read(reader_, good), false);
}

// Many new senders do not displace a sender that the reader has already accepted.
TEST_F(StopDatagramsTest, InventedButtonsDisplaceNone) {
  EXPECT_EQ(Read(reader_, writer_.Next(false, kNow)), false);
  int believed = 0;
  for (int n = 0; n < 100; ++n) {
    StopWriter invented({});
    believed += Read(reader_, invented.Next(false, kNow)).has_value() ? 1 : 0;
  }
  EXPECT_EQ(believed, 15);
  EXPECT_EQ(Read(reader_, writer_.Next(true, kNow)), true);
}

TEST(SecuredStopDatagramsTest, OnlyTheLabIsHeard) {
  const test::Keystore lab = {{"line_tracking", Permission::kController},
                              {"stop", Permission::kButton}};
  const test::Keystore others = {{"stop", Permission::kButton}};
  // Certificates are valid at the present time, not at kNow.
  const std::int64_t now_ns = Stamp::Now().nanoseconds();
  StopReader reader(lab.enclave("line_tracking"));
  StopWriter unsigned_writer({});
  StopWriter foreign(others.enclave("stop"));
  StopWriter writer(lab.enclave("stop"));
  EXPECT_EQ(Read(reader, unsigned_writer.Next(true, now_ns), now_ns), std::nullopt);
  EXPECT_EQ(Read(reader, foreign.Next(true, now_ns), now_ns), std::nullopt);
  const std::string good = writer.Next(false, now_ns);
  // Changes one bit and keeps the old signature: a later number, a press, another certificate, ...
  for (std::size_t at = 0; at < good.size(); at += at < 43 ? 1 : 29) {
    std::string changed = good;
    changed[at] = static_cast<char>(changed[at] ^ 1);
    EXPECT_EQ(Read(reader, changed, now_ns), std::nullopt) << at;
  }
  EXPECT_EQ(Read(reader, good.substr(0, good.size() - 1), now_ns), std::nullopt);
  EXPECT_EQ(Read(reader, good, now_ns), false);
  EXPECT_EQ(Read(reader, writer.Next(true, now_ns), now_ns), true);
  StopReader unsecured({});
  EXPECT_EQ(Read(unsecured, writer.Next(true, now_ns), now_ns), std::nullopt)
      << "it cannot verify the sender";
}

// Returns a datagram that says "not pressed" under the name and the certificate of different
// participants, with a number that follows all others.
std::string InTheNameOf(std::string_view button, std::string own, const std::string& key_file) {
  own.replace(8, 16, button.substr(8, 16));
  own.replace(24, 8, std::string("\x7f") + std::string(7, '\0'));
  const std::size_t size =
      static_cast<std::uint8_t>(own[41]) * 256U + static_cast<std::uint8_t>(own[42]);
  own.resize(43 + size);
  const internal::Owned<EVP_PKEY> key = internal::LoadKey(key_file);
  EVP_MD_CTX* const context = EVP_MD_CTX_new();
  std::array<unsigned char, 1024> signature;
  std::size_t signed_size = signature.size();
  EVP_DigestSignInit(context, nullptr, EVP_sha256(), nullptr, key.get());
  const auto* bytes = reinterpret_cast<const unsigned char*>(own.data());  // NOLINT: OpenSSL
  EXPECT_EQ(EVP_DigestSign(context, signature.data(), &signed_size, bytes, own.size()), 1);
  EVP_MD_CTX_free(context);
  return own.append(signature.begin(),
                    signature.begin() + static_cast<std::ptrdiff_t>(signed_size));
}

// Every participant may press. None can suppress the press of another.
TEST(SecuredStopDatagramsTest, AParticipantSendsOnlyInItsOwnName) {
  const test::Keystore lab = {{"line_tracking", Permission::kController},
                              {"stop", Permission::kButton},
                              {"monitor", Permission::kMonitor}};
  const std::int64_t now_ns = Stamp::Now().nanoseconds();
  StopReader reader(lab.enclave("line_tracking"));
  StopWriter button(lab.enclave("stop"));
  StopWriter monitor(lab.enclave("monitor"));
  const std::string good = button.Next(false, now_ns);
  StopSenderId stop{};
  bool pressed = true;
  ASSERT_TRUE(reader.Read(good, now_ns, stop, pressed));
  const std::string key = SecurityFiles(lab.enclave("monitor")).key.string();
  StopSenderId who{};
  const bool read =
      reader.Read(InTheNameOf(good, monitor.Next(false, now_ns), key), now_ns, who, pressed);
  EXPECT_TRUE(read) << "a sender of its own, whose silence also stops the robot";
  EXPECT_NE(who, stop);
  EXPECT_EQ(Read(reader, button.Next(true, now_ns), now_ns), true) << "the press is heard";
  EXPECT_EQ(Read(reader, monitor.Next(true, now_ns), now_ns), true) << "everyone may press";
}

}  // namespace
}  // namespace dfr::dds
