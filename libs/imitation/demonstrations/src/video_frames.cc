#include "video_frames.h"

#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <sstream>
#include <system_error>
#include <vector>

#include "dfr/core/error.h"
#include "socket_bytes.h"

namespace dfr::imitation::internal {
namespace {

constexpr char kDecoder[] = "video_frames";

// Returns the path of the decoder beside this program, or its name if PATH must be searched.
std::string Decoder() {
  std::error_code error;
  const std::filesystem::path beside =
      std::filesystem::read_symlink("/proc/self/exe", error).parent_path() / kDecoder;
  return !error && std::filesystem::exists(beside, error) ? beside.string() : kDecoder;
}

}  // namespace

void VideoFrames::Start() {
  std::array<int, 2> sockets{};
  if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, sockets.data()) != 0) {
    throw core::Error(std::string("cannot connect to the program ") + kDecoder + ": " +
                      std::strerror(errno));
  }
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, sockets[1], STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&actions, sockets[1], STDOUT_FILENO);
  std::string program = Decoder();
  const std::array<char*, 2> arguments = {program.data(), nullptr};
  const int error =
      posix_spawnp(&process_, program.c_str(), &actions, nullptr, arguments.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  close(sockets[1]);
  if (error != 0) {
    close(sockets[0]);
    process_ = -1;
    throw core::Error(
        std::string("the program ") + kDecoder +
            ", which decodes videos, does not start: " + std::strerror(error),
        "build the component video_frames, which needs OpenCV's videoio, or install the package "
        "dfr-video-frames");
  }
  socket_ = sockets[0];
}

std::string VideoFrames::End() noexcept {
  if (socket_ >= 0) close(socket_);
  socket_ = -1;
  if (process_ <= 0) return "";
  int status = 0;
  // The process has nothing to clean up.
  const bool alive = waitpid(process_, &status, WNOHANG) == 0;
  if (alive) {
    kill(process_, SIGKILL);
    while (waitpid(process_, &status, 0) < 0 && errno == EINTR) {
    }
  }
  process_ = -1;
  return !alive && WIFSIGNALED(status)
             ? std::string(" by signal ") + std::to_string(WTERMSIG(status))
             : "";
}

void VideoFrames::Read(const VideoClip& clip, Eigen::Ref<core::Matrix> frames) {
  const std::string file = clip.file.string();
  if (!std::filesystem::exists(clip.file)) {
    throw core::Error("does not exist", "check that the download of the videos is complete");
  }
  if (file.find('\n') != std::string::npos) {
    throw core::Error("has a line break in its name", "rename it");
  }
  if (process_ < 0) Start();
  std::ostringstream request;
  request.precision(17);
  request << clip.camera << ' ' << clip.first << ' ' << clip.count << ' ' << clip.fps << ' '
          << clip.height << ' ' << clip.width << ' ' << clip.out_height << ' ' << clip.out_width
          << ' ' << file << '\n';
  const std::string text = request.str();
  const auto fail = [&] {
    throw core::Error("the program that decodes it has ended" + End(),
                      "the file may be damaged: download it again");
  };
  if (!SendAll(socket_, text.data(), text.size())) fail();
  const Eigen::Index pixels = Eigen::Index{clip.out_height} * clip.out_width;
  const Eigen::Index step = 3 * pixels / frames.cols();
  std::vector<unsigned char> bytes(static_cast<std::size_t>(3 * pixels));
  for (std::int64_t i = 0; i < clip.count; ++i) {
    char mark = 0;
    if (!ReceiveAll(socket_, &mark, 1)) fail();
    if (mark != '+') {
      std::string reason;
      for (char c = 0; c != '\n'; reason += c) {
        if (!ReceiveAll(socket_, &c, 1)) fail();
      }
      reason.pop_back();
      throw std::runtime_error(reason);
    }
    if (!ReceiveAll(socket_, bytes.data(), bytes.size())) fail();
    for (Eigen::Index k = 0; k < frames.cols(); ++k) {
      frames(i, k) = bytes[static_cast<std::size_t>(k * step)];
    }
  }
}

}  // namespace dfr::imitation::internal
