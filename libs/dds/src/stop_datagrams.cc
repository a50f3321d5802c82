#include "stop_datagrams.h"

#include <arpa/inet.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <openssl/rand.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>
#include <stdexcept>

#include "dfr/dds/security.h"

namespace dfr::dds::internal {
namespace {

constexpr std::string_view kMagic("dfrstop1", 8);
// A datagram contains magic bytes, sender, number, time, 1 if pressed (else 0), size of the
// certificate (2 bytes), certificate, and signature of all preceding bytes. All integers are
// big-endian.
constexpr std::size_t kIdAt = 8;
constexpr std::size_t kSequenceAt = 24;
constexpr std::size_t kTimeAt = 32;
constexpr std::size_t kPressedAt = 40;
constexpr std::size_t kSizeAt = 41;
constexpr std::size_t kHead = 43;
constexpr std::size_t kLargest = 4096;
constexpr std::int64_t kMostAstrayNs = 1'000'000'000;
constexpr int kMostPassedOver = 16;

void Put(std::uint64_t number, std::size_t bytes, std::string& out) {
  for (std::size_t i = bytes; i > 0; --i) out += static_cast<char>(number >> (8 * (i - 1)));
}

std::uint64_t Get(std::string_view in, std::size_t at, std::size_t bytes) {
  std::uint64_t number = 0;
  for (std::size_t i = 0; i < bytes; ++i) {
    number = number << 8U | static_cast<std::uint8_t>(in[at + i]);
  }
  return number;
}

const unsigned char* Bytes(std::string_view text) {
  return reinterpret_cast<const unsigned char*>(text.data());  // NOLINT: OpenSSL's bytes
}

sockaddr_in Address(std::uint32_t host_order, std::uint16_t port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(host_order);
  address.sin_port = htons(port);
  return address;
}

struct DigestDeleter {
  void operator()(EVP_MD_CTX* context) const { EVP_MD_CTX_free(context); }
};
using Digest = std::unique_ptr<EVP_MD_CTX, DigestDeleter>;

std::string Sign(EVP_PKEY* key, std::string_view text) {
  const Digest digest(EVP_MD_CTX_new());
  std::size_t size = 0;
  if (!digest || EVP_DigestSignInit(digest.get(), nullptr, EVP_sha256(), nullptr, key) != 1 ||
      EVP_DigestSign(digest.get(), nullptr, &size, Bytes(text), text.size()) != 1) {
    return {};
  }
  std::string signature(size, '\0');
  auto* bytes = reinterpret_cast<unsigned char*>(signature.data());  // NOLINT: OpenSSL's bytes
  if (EVP_DigestSign(digest.get(), bytes, &size, Bytes(text), text.size()) != 1) return {};
  signature.resize(size);
  return signature;
}

bool Verify(EVP_PKEY* key, std::string_view text, std::string_view signature) {
  const Digest digest(EVP_MD_CTX_new());
  return digest && EVP_DigestVerifyInit(digest.get(), nullptr, EVP_sha256(), nullptr, key) == 1 &&
         EVP_DigestVerify(digest.get(), Bytes(signature), signature.size(), Bytes(text),
                          text.size()) == 1;
}

std::string Refused(const char* what) {
  return std::string("the emergency stop's datagrams: ") + what + ": " + std::strerror(errno);
}

}  // namespace

std::uint16_t StopPort(int domain) noexcept {
  // DDS uses the ports 7400 + 250 * domain + offset, with offsets 0, 1 and 10 or more.
  return static_cast<std::uint16_t>(7400 + 250 * domain + 5);
}

StopSocket::StopSocket()
    : socket_(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0)) {
  if (socket_ < 0) throw std::runtime_error(Refused("cannot open a socket"));
}

StopSocket::~StopSocket() { ::close(socket_); }

StopWriter::StopWriter(const std::filesystem::path& security) {
  if (RAND_bytes(id_.data(), static_cast<int>(id_.size())) != 1) {
    throw std::runtime_error("OpenSSL cannot generate random numbers: " + Complaint());
  }
  if (security.empty()) return;
  const SecurityFiles files(security);
  key_ = LoadKey(files.key);
  const Owned<X509> certificate = LoadCertificate(files.certificate);
  unsigned char* der = nullptr;
  const int size = i2d_X509(certificate.get(), &der);
  if (size <= 0) throw std::runtime_error(files.certificate.string() + ": " + Complaint());
  certificate_.assign(reinterpret_cast<const char*>(der),  // NOLINT: OpenSSL's bytes
                      static_cast<std::size_t>(size));
  OPENSSL_free(der);
}

std::string StopWriter::Next(bool pressed, std::int64_t wall_ns) {
  std::string datagram(kMagic);
  datagram.append(id_.begin(), id_.end());
  Put(++sequence_, 8, datagram);
  Put(static_cast<std::uint64_t>(wall_ns), 8, datagram);
  Put(pressed ? 1U : 0U, 1, datagram);
  Put(certificate_.size(), 2, datagram);
  datagram += certificate_;
  if (key_) datagram += Sign(key_.get(), datagram);
  return datagram;
}

StopReader::StopReader(const std::filesystem::path& security) {
  if (security.empty()) return;
  const SecurityFiles files(security);
  authority_.reset(X509_STORE_new());
  const Owned<X509> ca = LoadCertificate(files.identity_ca);
  if (!authority_ || X509_STORE_add_cert(authority_.get(), ca.get()) != 1) {
    throw std::runtime_error(files.identity_ca.string() + ": " + Complaint());
  }
}

bool StopReader::Signed(std::string_view datagram) {
  const auto size = static_cast<std::size_t>(Get(datagram, kSizeAt, 2));
  if (!authority_) return size == 0 && datagram.size() == kHead;
  if (size == 0 || datagram.size() <= kHead + size) return false;
  const std::string_view certificate = datagram.substr(kHead, size);
  if (certificate != last_certificate_ || !last_key_) {
    const unsigned char* der = Bytes(certificate);
    const Owned<X509> sender(d2i_X509(nullptr, &der, static_cast<long>(size)));  // NOLINT: API type
    const Owned<X509_STORE_CTX> context(X509_STORE_CTX_new());
    if (!sender || !context ||
        X509_STORE_CTX_init(context.get(), authority_.get(), sender.get(), nullptr) != 1 ||
        X509_verify_cert(context.get()) != 1) {
      static_cast<void>(Complaint());
      return false;
    }
    last_key_.reset(X509_get_pubkey(sender.get()));
    last_certificate_ = certificate;
  }
  const bool good = last_key_ && Verify(last_key_.get(), datagram.substr(0, kHead + size),
                                        datagram.substr(kHead + size));
  if (!good) static_cast<void>(Complaint());
  return good;
}

StopSenderId StopReader::SenderOf(std::string_view datagram) const {
  StopSenderId id;
  std::copy_n(datagram.begin() + kIdAt, id.size(), id.begin());
  if (!authority_) return id;
  const auto size = static_cast<std::size_t>(Get(datagram, kSizeAt, 2));
  std::string named(datagram.substr(kIdAt, id.size()));
  named += datagram.substr(kHead, size);
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest;
  unsigned int digest_size = 0;
  if (EVP_Digest(named.data(), named.size(), digest.data(), &digest_size, EVP_sha256(), nullptr) !=
      1) {
    throw std::runtime_error("OpenSSL cannot compute a digest: " + Complaint());
  }
  std::copy_n(digest.begin(), id.size(), id.begin());
  return id;
}

bool StopReader::New(const StopSenderId& who, std::uint64_t sequence, std::int64_t wall_ns) {
  auto known = std::find_if(known_.begin(), known_.end(),
                            [&](const Known& k) { return k.sequence > 0 && k.who == who; });
  if (known == known_.end()) {
    // Replaces a sender that has been silent for so long that a replayed datagram would be too old.
    known = std::find_if(known_.begin(), known_.end(), [&](const Known& k) {
      return k.sequence == 0 || wall_ns - k.heard_ns > 2 * kMostAstrayNs;
    });
    if (known == known_.end()) return false;
    *known = {who, 0, wall_ns};
  }
  if (sequence <= known->sequence) return false;
  known->sequence = sequence;
  known->heard_ns = wall_ns;
  return true;
}

bool StopReader::Read(std::string_view datagram, std::int64_t wall_ns, StopSenderId& who,
                      bool& pressed) {
  if (datagram.size() < kHead || datagram.size() > kLargest || !datagram.starts_with(kMagic)) {
    return false;
  }
  const auto sent_ns = static_cast<std::int64_t>(Get(datagram, kTimeAt, 8));
  const auto flag = static_cast<std::uint8_t>(datagram[kPressedAt]);
  if (flag > 1 || !Signed(datagram)) return false;
  clocks_differ_ = sent_ns < wall_ns - kMostAstrayNs || sent_ns > wall_ns + kMostAstrayNs;
  if (clocks_differ_) return false;
  const StopSenderId id = SenderOf(datagram);
  if (!New(id, Get(datagram, kSequenceAt, 8), wall_ns)) return false;
  who = id;
  pressed = flag == 1;
  return true;
}

StopSender::StopSender(const ParticipantOptions& options) : writer_(options.security) {
  const int yes = 1;
  if (::setsockopt(socket_.get(), SOL_SOCKET, SO_BROADCAST, &yes, sizeof yes) != 0) {
    throw std::runtime_error(Refused("cannot broadcast"));
  }
  const std::uint16_t port = StopPort(options.domain);
  listeners_.push_back(Address(0x7fffffff, port));  // 127.255.255.255
  ifaddrs* interfaces = nullptr;
  if (options.discovery != Discovery::kLoopback && ::getifaddrs(&interfaces) == 0) {
    for (const ifaddrs* i = interfaces; i != nullptr; i = i->ifa_next) {
      const bool sends = (i->ifa_flags & IFF_UP) != 0 && (i->ifa_flags & IFF_BROADCAST) != 0;
      if (!sends || i->ifa_broadaddr == nullptr || i->ifa_broadaddr->sa_family != AF_INET) continue;
      sockaddr_in all{};
      std::memcpy(&all, i->ifa_broadaddr, sizeof all);
      listeners_.push_back(Address(ntohl(all.sin_addr.s_addr), port));
    }
    ::freeifaddrs(interfaces);
  }
}

bool StopSender::Send(bool pressed, std::int64_t wall_ns) noexcept {
  try {
    const std::string datagram = writer_.Next(pressed, wall_ns);
    bool sent = false;
    for (const sockaddr_in& listener : listeners_) {
      const auto* address = reinterpret_cast<const sockaddr*>(&listener);  // NOLINT: sockets API
      sent = ::sendto(socket_.get(), datagram.data(), datagram.size(), MSG_NOSIGNAL, address,
                      sizeof listener) == static_cast<ssize_t>(datagram.size()) ||
             sent;
    }
    return sent;
  } catch (const std::exception&) {
    return false;
  }
}

StopListener::StopListener(const ParticipantOptions& options)
    : loopback_(options.discovery == Discovery::kLoopback), reader_(options.security) {
  const int yes = 1;
  const sockaddr_in any = Address(INADDR_ANY, StopPort(options.domain));
  const auto* address = reinterpret_cast<const sockaddr*>(&any);  // NOLINT: sockets API
  if (::setsockopt(socket_.get(), SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes) != 0 ||
      ::bind(socket_.get(), address, sizeof any) != 0) {
    throw std::runtime_error(
        Refused(("cannot listen on UDP port " + std::to_string(StopPort(options.domain))).c_str()));
  }
}

bool StopListener::Take(std::int64_t wall_ns, StopSenderId& who, bool& pressed) noexcept {
  try {
    std::array<char, kLargest> buffer;
    for (int n = 0; n < kMostPassedOver; ++n) {
      sockaddr_in from{};
      socklen_t from_size = sizeof from;
      auto* address = reinterpret_cast<sockaddr*>(&from);  // NOLINT: sockets API
      const ssize_t size =
          ::recvfrom(socket_.get(), buffer.data(), buffer.size(), MSG_TRUNC, address, &from_size);
      if (size < 0) return false;
      if (static_cast<std::size_t>(size) > kLargest) continue;
      const std::string_view datagram(buffer.data(), static_cast<std::size_t>(size));
      const bool here = (ntohl(from.sin_addr.s_addr) >> 24U) == 127;
      if (loopback_ && !here) continue;
      if (reader_.Read(datagram, wall_ns, who, pressed)) return true;
    }
  } catch (const std::exception&) {
    return false;
  }
  return false;
}

}  // namespace dfr::dds::internal
