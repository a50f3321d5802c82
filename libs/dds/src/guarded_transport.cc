#include "guarded_transport.h"

#include <fastdds/rtps/transport/ChainingTransport.h>
#include <fastdds/rtps/transport/ChainingTransportDescriptor.h>

#include <algorithm>
#include <chrono>
#include <exception>

namespace dfr::dds::internal {
namespace {

namespace rtps = eprosima::fastrtps::rtps;
namespace transport = eprosima::fastdds::rtps;

constexpr std::array<std::uint8_t, 4> kRtpsMagic = {'R', 'T', 'P', 'S'};
constexpr std::size_t kPrefixAt = 8;    // position of the sender's prefix
constexpr std::size_t kHeader = 20;     // size of a message's header
constexpr std::size_t kSubheader = 4;   // size of a submessage's kind, flags and length
constexpr std::uint8_t kPad = 0x01;     // length 0 means empty
constexpr std::uint8_t kInfoTs = 0x09;  // length 0 means empty
constexpr std::uint8_t kData = 0x15;
constexpr std::uint8_t kDataFragment = 0x16;
constexpr std::uint8_t kStatistics = 0x80;
constexpr std::size_t kStatus = 0x71;  // parameter that announces the end of an entity

// Returns the unsigned integer of `size` bytes at `at`.
std::size_t ReadInteger(std::span<const std::uint8_t> bytes, std::size_t at, std::size_t size,
                        bool little) noexcept {
  std::size_t number = 0;
  for (std::size_t k = 0; k < size; ++k) {
    number = (number << 8U) + bytes[at + (little ? size - 1 - k : k)];
  }
  return number;
}

struct Parameters {
  std::size_t size = 0;  // including the end marker; 0 if it is missing
  bool found = false;    // the requested parameter is present
};

Parameters FindParameters(std::span<const std::uint8_t> bytes, bool little,
                          std::size_t wanted) noexcept {
  constexpr std::size_t kEnd = 1;
  bool found = false;
  std::size_t at = 0;
  while (at <= bytes.size() && bytes.size() - at >= 4) {
    const std::size_t name = ReadInteger(bytes, at, 2, little);
    const std::size_t length = ReadInteger(bytes, at + 2, 2, little);
    at += 4;
    if (name == kEnd) return {at, found};
    found = found || name == wanted;
    at += (length + 3) & ~std::size_t{3};
  }
  return {};
}

// Returns true if the flags and sizes of a sample, or of its fragments, agree with the length of
// `content`. Otherwise Fast DDS 2.9 frees memory that it does not own, or reads beyond the message.
bool WholeSample(std::uint8_t kind, std::uint8_t flags,
                 std::span<const std::uint8_t> content) noexcept {
  constexpr std::uint8_t kParameters = 2;
  const bool fragments = kind == kDataFragment;
  const bool little = (flags & 1U) != 0;
  const bool has_data = fragments || (flags & 4U) != 0;
  const bool has_key = (flags & (fragments ? 4U : 8U)) != 0;
  if (has_data && has_key) return false;
  const std::size_t head = fragments ? 32 : 20;
  if (content.size() < head) return false;
  std::size_t at = 4 + ReadInteger(content, 2, 2, little);
  if (at < head || at > content.size()) return false;
  if ((flags & kParameters) != 0) {
    const std::size_t size = FindParameters(content.subspan(at), little, kStatus).size;
    if (size == 0) return false;
    at += size;
  }
  const std::size_t payload = content.size() - at;
  if (!has_data) return !has_key || payload > 0;
  if (!fragments) return payload > 0;
  const std::size_t first = ReadInteger(content, 20, 4, little);
  const std::size_t count = ReadInteger(content, 24, 2, little);
  const std::size_t size = ReadInteger(content, 26, 2, little);
  const std::size_t whole = ReadInteger(content, 28, 4, little);
  return payload > 0 && first > 0 && count > 0 && size > 0 && payload <= count * size &&
         (first - 1 + count - 1) * size < whole;
}

// Returns true if a well-formed sample announces that a participant leaves.
bool EndsParticipant(std::uint8_t kind, std::uint8_t flags,
                     std::span<const std::uint8_t> content) noexcept {
  constexpr std::array<std::uint8_t, 4> kAnnouncer = {0, 1, 0, 0xc2};
  if (!std::equal(kAnnouncer.begin(), kAnnouncer.end(), content.begin() + 8)) return false;
  // Flag 4 marks data in a whole sample, but a key in a fragment.
  const bool has_data = (kind == kData) == ((flags & 4U) != 0);
  if (!has_data) return true;
  if ((flags & 2U) == 0) return false;
  const bool little = (flags & 1U) != 0;
  return FindParameters(content.subspan(4 + ReadInteger(content, 2, 2, little)), little, kStatus)
      .found;
}

// Participants of this process that are ending, or ended a few seconds ago.
class Leaving {
 public:
  void Add(const ParticipantPrefix& prefix) {
    const std::lock_guard lock(mutex_);
    const auto now = Clock::now();
    std::erase_if(since_, [&](const auto& entry) { return now - entry.second > kSeconds; });
    since_[prefix] = now;
  }
  [[nodiscard]] bool Has(const ParticipantPrefix& prefix) {
    const std::lock_guard lock(mutex_);
    const auto found = since_.find(prefix);
    return found != since_.end() && Clock::now() - found->second <= kSeconds;
  }

 private:
  using Clock = std::chrono::steady_clock;
  static constexpr std::chrono::seconds kSeconds{5};

  std::mutex mutex_;
  std::map<ParticipantPrefix, Clock::time_point> since_;
};

// Never destroyed: threads of Fast DDS may run until the process ends.
Leaving& TheLeaving() {
  static auto* const leaving = new Leaving;
  return *leaving;
}

class GuardedTransport final : public transport::ChainingTransport {
 public:
  using ChainingTransport::ChainingTransport;

  transport::TransportDescriptorInterface* get_configuration() override {
    return low_level_transport_->get_configuration();
  }
  bool send(rtps::SenderResource* sender, const rtps::octet* data, std::uint32_t size,
            rtps::LocatorsIterator* begin, rtps::LocatorsIterator* end,
            const std::chrono::steady_clock::time_point& timeout) override {
    return sender->send(data, size, begin, end, timeout);
  }
  void receive(transport::TransportReceiverInterface* next, const rtps::octet* data,
               std::uint32_t size, const rtps::Locator_t& local,
               const rtps::Locator_t& remote) override {
    if (size < kHeader) return;
    ParticipantPrefix prefix;
    std::copy_n(data + kPrefixAt, prefix.size(), prefix.begin());
    const std::size_t safe = SafeSize({data, size}, TheLeaving().Has(prefix));
    if (safe == 0) return;
    ParticipantCensus::Address address;
    std::copy_n(remote.address, address.size(), address.begin());
    const auto now = std::chrono::steady_clock::now().time_since_epoch();
    try {
      if (!census_.Admits(address, prefix, std::chrono::nanoseconds(now).count())) return;
    } catch (const std::exception&) {
      return;  // out of memory: drops the message
    }
    next->OnDataReceived(data, static_cast<std::uint32_t>(safe), local, remote);
  }

 private:
  ParticipantCensus census_;
};

struct GuardedDescriptor final : transport::ChainingTransportDescriptor {
  using ChainingTransportDescriptor::ChainingTransportDescriptor;
  transport::TransportInterface* create_transport() const override {
    return new GuardedTransport(*this);  // Fast DDS deletes it
  }
};

}  // namespace

void Leaves(const ParticipantPrefix& prefix) { TheLeaving().Add(prefix); }

std::size_t SafeSize(std::span<const std::uint8_t> message, bool may_leave) noexcept {
  if (message.size() < kHeader ||
      !std::equal(kRtpsMagic.begin(), kRtpsMagic.end(), message.begin())) {
    return 0;
  }
  std::size_t at = kHeader;
  while (at < message.size()) {
    if (message.size() - at < kSubheader) return 0;
    const std::uint8_t kind = message[at];
    if (kind == kStatistics) break;
    const bool little = (message[at + 1] & 1U) != 0;
    const std::size_t low = message[at + (little ? 2 : 3)];
    const std::size_t high = message[at + (little ? 3 : 2)];
    const std::size_t length = low + (high << 8U);
    const std::size_t rest = message.size() - at - kSubheader;
    // A last submessage of length 0 extends to the message's end.
    const bool last = length == 0 && kind != kPad && kind != kInfoTs;
    if (length > rest) return 0;
    const auto content = message.subspan(at + kSubheader, last ? rest : length);
    if (kind == kData || kind == kDataFragment) {
      if (!WholeSample(kind, message[at + 1], content)) return 0;
      if (!may_leave && EndsParticipant(kind, message[at + 1], content)) break;
    }
    if (last) return message.size();
    at += kSubheader + length;
  }
  return at == kHeader ? 0 : at;
}

void ParticipantCensus::Forget(std::int64_t steady_ns) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  if (steady_ns - swept_ns_ < kSecond) return;
  swept_ns_ = steady_ns;
  std::erase_if(heard_ns_, [&](const auto& entry) {
    if (steady_ns - entry.second <= kForgotten_s * kSecond) return false;
    const auto count = count_.find(entry.first.first);
    if (--count->second == 0) count_.erase(count);
    return true;
  });
}

bool ParticipantCensus::Admits(const Address& address, const Prefix& prefix,
                               std::int64_t steady_ns) {
  const std::lock_guard lock(mutex_);
  const std::pair key(address, prefix);
  auto known = heard_ns_.find(key);
  if (known == heard_ns_.end()) {
    Forget(steady_ns);
    const auto count = count_.find(address);
    if (heard_ns_.size() >= kInAll || (count != count_.end() && count->second >= kPerAddress)) {
      return false;
    }
    known = heard_ns_.emplace(key, steady_ns).first;
    ++count_[address];
  }
  known->second = steady_ns;
  return true;
}

std::shared_ptr<transport::TransportDescriptorInterface> Guarded(
    std::shared_ptr<transport::TransportDescriptorInterface> transport) {
  return std::make_shared<GuardedDescriptor>(std::move(transport));
}

}  // namespace dfr::dds::internal
