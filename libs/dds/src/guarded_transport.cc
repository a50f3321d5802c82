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

constexpr std::array<std::uint8_t, 4> kMagic = {'R', 'T', 'P', 'S'};
constexpr std::size_t kPrefixAt = 8;    // in the message's header
constexpr std::size_t kHeader = 20;     // of a message
constexpr std::size_t kSubheader = 4;   // of a submessage: kind, flags, length
constexpr std::uint8_t kPad = 0x01;     // may have no content, and so may
constexpr std::uint8_t kInfoTs = 0x09;  // this one
constexpr std::uint8_t kStatistics = 0x80;

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
    const std::size_t safe = SafeSize({data, size});
    if (safe == 0) return;
    ParticipantCensus::Prefix prefix;
    std::copy_n(data + kPrefixAt, prefix.size(), prefix.begin());
    ParticipantCensus::Address address;
    std::copy_n(remote.address, address.size(), address.begin());
    const auto now = std::chrono::steady_clock::now().time_since_epoch();
    try {
      if (!census_.Admits(address, prefix, std::chrono::nanoseconds(now).count())) return;
    } catch (const std::exception&) {
      return;  // no memory left to count with
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

std::size_t SafeSize(std::span<const std::uint8_t> message) noexcept {
  if (message.size() < kHeader || !std::equal(kMagic.begin(), kMagic.end(), message.begin())) {
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
    // A last submessage of length 0 goes on to the end.
    if (length == 0 && kind != kPad && kind != kInfoTs) return message.size();
    if (length > message.size() - at - kSubheader) return 0;
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
