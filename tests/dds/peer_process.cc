#include "tests/dds/peer_process.h"

#include <signal.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <stdexcept>

namespace dfr::test {
namespace {

// Settings for a loopback without multicast.
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
    // With another parent, the test ended before the call of prctl.
    if (::getppid() == test) ::execv(argv[0], argv.data());
    ::_exit(127);
  }
  if (pid_ < 0) throw std::runtime_error("cannot run " + command.front());
}

PeerProcess::~PeerProcess() {
  if (pid_ < 0) return;
  ::kill(pid_, SIGKILL);
  ::waitpid(pid_, nullptr, 0);
}

void PeerProcess::Signal(int number) const {
  if (pid_ > 0) ::kill(pid_, number);
}

std::optional<int> PeerProcess::Ended() { return Reap(WNOHANG); }

int PeerProcess::Await() { return Reap(0).value_or(-1); }

std::optional<int> PeerProcess::Reap(int options) {
  if (code_) return code_;
  int status = 0;
  pid_t ended = -1;
  do {
    ended = ::waitpid(pid_, &status, options);
  } while (ended < 0 && errno == EINTR);
  if (ended != pid_) return std::nullopt;
  pid_ = -1;
  code_ = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return code_;
}

}  // namespace dfr::test
