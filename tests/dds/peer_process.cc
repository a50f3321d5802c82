#include "tests/dds/peer_process.h"

#include <signal.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <stdexcept>
#include <thread>

namespace dfr::test {
namespace {

// What a loopback without multicast needs.
constexpr const char* kCycloneLoopback =
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface "
    "address=\"127.0.0.1\"/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto"
    "</ParticipantIndex><MaxAutoParticipantIndex>24</MaxAutoParticipantIndex><Peers><Peer "
    "address=\"127.0.0.1\"/></Peers></Discovery></Domain></CycloneDDS>";

}  // namespace

PeerProcess::PeerProcess(const std::vector<std::string>& command) {
  ::setenv("CYCLONEDDS_URI", kCycloneLoopback, 1);
  std::vector<char*> argv;
  argv.reserve(command.size() + 1);
  for (const std::string& argument : command) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  const pid_t test = ::getpid();
  if (::access(argv[0], X_OK) == 0) pid_ = ::fork();
  if (pid_ == 0) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (::getppid() == test) ::execv(argv[0], argv.data());  // else it is too late to hear of it
    ::_exit(127);
  }
  if (pid_ < 0) throw std::runtime_error("cannot run " + command.front());
}

PeerProcess::~PeerProcess() {
  if (pid_ < 0) return;
  ::kill(pid_, SIGKILL);
  ::waitpid(pid_, nullptr, 0);
}

void PeerProcess::Signal(int number) const { ::kill(pid_, number); }

int PeerProcess::Await(double timeout_s) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(timeout_s);
  while (std::chrono::steady_clock::now() < end) {
    int status = 0;
    if (::waitpid(pid_, &status, WNOHANG) == pid_) {
      pid_ = -1;
      return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return -1;
}

}  // namespace dfr::test
