#include "lossy_wire.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <linux/if_tun.h>
#include <net/if.h>
#include <poll.h>
#include <sched.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <queue>
#include <stdexcept>
#include <system_error>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/runtime/periodic_timer.h"

namespace dfr::bench {
namespace {

constexpr const char* kInterface = "wire0";

[[noreturn]] void Fail(const std::string& what) {
  throw std::runtime_error(what + ": " + std::generic_category().message(errno));
}

void Request(int fd, unsigned long number, ifreq& request, const std::string& what) {
  if (ioctl(fd, number, &request) != 0) Fail(what);
}

ifreq Interface(const char* name) {
  ifreq request{};
  std::strncpy(request.ifr_name, name, IFNAMSIZ - 1);
  return request;
}

void BringUp(int socket, const char* name) {
  ifreq request = Interface(name);
  Request(socket, SIOCGIFFLAGS, request, name);
  request.ifr_flags = static_cast<short>(request.ifr_flags | IFF_UP | IFF_RUNNING);
  Request(socket, SIOCSIFFLAGS, request, name);
}

sockaddr Address(const char* text) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  inet_pton(AF_INET, text, &address.sin_addr);
  sockaddr result;
  static_assert(sizeof result == sizeof address);
  std::memcpy(&result, &address, sizeof result);
  return result;
}

// The root user of a user namespace may create network namespaces.
void BecomeRoot() {
  const uid_t uid = getuid();
  const gid_t gid = getgid();
  if (unshare(CLONE_NEWUSER) != 0) Fail("cannot create a user namespace");
  std::ofstream("/proc/self/setgroups") << "deny";
  std::ofstream("/proc/self/uid_map") << "0 " << uid << " 1";
  std::ofstream("/proc/self/gid_map") << "0 " << gid << " 1";
}

void EnterNewNetwork() {
  if (unshare(CLONE_NEWNET) == 0) return;
  if (errno != EPERM) Fail("cannot create a network namespace");
  BecomeRoot();
  if (unshare(CLONE_NEWNET) != 0) Fail("cannot create a network namespace");
}

// Moves this process to a new network namespace.
// @return the end of its cable: a packet written there arrives at the host.
int MakeHost(const char* address) {
  EnterNewNetwork();
  const int tap = open("/dev/net/tun", O_RDWR | O_NONBLOCK | O_CLOEXEC);
  if (tap < 0) Fail("/dev/net/tun");
  ifreq request = Interface(kInterface);
  request.ifr_flags = IFF_TAP | IFF_NO_PI;
  Request(tap, TUNSETIFF, request, "no interface");
  const int control = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (control < 0) Fail("no socket");
  request = Interface(kInterface);
  request.ifr_addr = Address(address);
  Request(control, SIOCSIFADDR, request, "no address");
  request.ifr_netmask = Address("255.255.255.0");
  Request(control, SIOCSIFNETMASK, request, "no netmask");
  // A picture arrives as a burst of 615 packets. Without permission, the queue stays at 1000.
  request = Interface(kInterface);
  request.ifr_qlen = 10000;
  static_cast<void>(ioctl(control, SIOCSIFTXQLEN, &request));
  BringUp(control, kInterface);
  BringUp(control, "lo");
  close(control);
  // Incomplete datagrams would occupy their memory for half a minute; docs/robot.md recommends this
  // setting for lossy networks. Without permission to set it, trials take longer.
  std::ofstream("/proc/sys/net/ipv4/ipfrag_time") << 1;
  std::ofstream("/proc/sys/net/ipv4/ipfrag_high_thresh") << (128 << 20);
  return tap;
}

// Creates a host in a separate process as a trial, because a partial move cannot be undone.
// @throws std::runtime_error with the reason if hosts cannot be created.
void Try() {
  std::array<int, 2> reason{};
  if (pipe2(reason.data(), O_CLOEXEC) != 0) Fail("no pipe");
  const pid_t pid = fork();
  if (pid == 0) {
    try {
      MakeHost("10.77.0.1");
    } catch (const std::exception& e) {
      static_cast<void>(!write(reason[1], e.what(), std::strlen(e.what())));
    }
    _exit(EXIT_SUCCESS);
  }
  close(reason[1]);
  if (pid < 0) Fail("no process");
  std::array<char, 256> text;
  const ssize_t size = read(reason[0], text.data(), text.size());
  close(reason[0]);
  waitpid(pid, nullptr, 0);
  if (size > 0) throw std::runtime_error(std::string(text.data(), static_cast<size_t>(size)));
}

struct Packet {
  std::int64_t due_ns;
  std::uint64_t number;  // order of packets due at the same time
  int to;
  std::vector<char> bytes;
  bool operator<(const Packet& other) const {  // the packet due first is on top
    return due_ns != other.due_ns ? due_ns > other.due_ns : number > other.number;
  }
};

}  // namespace

LossyWire::LossyWire(std::uint64_t seed) {
  Try();
  far_tap_ = MakeHost("10.77.0.2");
  far_namespace_ = open("/proc/self/ns/net", O_RDONLY | O_CLOEXEC);
  if (far_namespace_ < 0) Fail("/proc/self/ns/net");
  near_tap_ = MakeHost("10.77.0.1");
  carrier_ = std::thread([this, seed] { Carry(seed); });
}

LossyWire::~LossyWire() {
  end_ = true;
  carrier_.join();
  close(near_tap_);
  close(far_tap_);
  close(far_namespace_);
}

void LossyWire::Disturb(double loss, double jitter_s) noexcept {
  loss_ = loss;
  jitter_s_ = jitter_s;
}

bool LossyWire::EnterFarHost() const noexcept { return setns(far_namespace_, CLONE_NEWNET) == 0; }

void LossyWire::Carry(std::uint64_t seed) {
  core::Random random(seed);
  std::priority_queue<Packet> under_way;
  std::uint64_t number = 0;
  std::array<char, 65536> buffer;
  std::array<pollfd, 2> taps = {pollfd{near_tap_, POLLIN, 0}, pollfd{far_tap_, POLLIN, 0}};
  while (!end_) {
    constexpr std::int64_t kLongest = 50'000'000;  // interval of the check for the end
    std::int64_t wait_ns = kLongest;
    if (!under_way.empty()) {
      wait_ns =
          std::clamp<std::int64_t>(under_way.top().due_ns - runtime::SteadyNow(), 0, kLongest);
    }
    const timespec timeout{0, wait_ns};
    ppoll(taps.data(), taps.size(), &timeout, nullptr);
    const double loss = loss_;
    const double jitter_ns = 1e9 * jitter_s_;
    for (std::size_t from = 0; from < taps.size(); ++from) {
      const int to = taps[1 - from].fd;
      for (ssize_t size = 0; (size = read(taps[from].fd, buffer.data(), buffer.size())) > 0;) {
        if (random.Uniform() < loss) continue;
        const std::size_t length = static_cast<std::size_t>(size);
        if (jitter_ns <= 0.0 && under_way.empty()) {
          // A host that cannot accept the packet loses it, as a real host does.
          static_cast<void>(!write(to, buffer.data(), length));
          continue;
        }
        const std::int64_t delay_ns = std::llround(random.Uniform(0.0, std::max(jitter_ns, 1.0)));
        under_way.push({runtime::SteadyNow() + delay_ns,
                        number++,
                        to,
                        {buffer.begin(), buffer.begin() + size}});
      }
    }
    while (!under_way.empty() && under_way.top().due_ns <= runtime::SteadyNow()) {
      const Packet& packet = under_way.top();
      static_cast<void>(!write(packet.to, packet.bytes.data(), packet.bytes.size()));
      under_way.pop();
    }
  }
}

}  // namespace dfr::bench
