#include "hdf5/hdf5_reader.h"

#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <exception>
#include <fstream>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "dfr/core/files/read_file.h"
#include "hdf5/hdf5_file.h"
#include "socket_bytes.h"

namespace dfr::imitation::internal {
namespace {

// A request is a letter and two strings. An answer is a size and that number of bytes. The first
// byte of an answer marks success or an error.
constexpr char kOpened = 'o';
constexpr char kExists = 'e';
constexpr char kIsGroup = 'g';
constexpr char kMembers = 'm';
constexpr char kShape = 's';
constexpr char kIsNumeric = 'n';
constexpr char kRead = 'r';
constexpr char kReadTexts = 't';
constexpr char kIntegerAttribute = 'i';
constexpr char kTextAttribute = 'a';

constexpr char kGood = '+';
constexpr char kNone = '0';
constexpr char kError = '-';

// Limits of the reading process: libhdf5's memory in addition to the values, and kSeconds of CPU
// time plus the time to read the file at kBytesPerSecond.
constexpr rlim_t kOverhead = rlim_t{128} << 20;
constexpr rlim_t kSeconds = 2;
constexpr rlim_t kBytesPerSecond = 20'000'000;

void Append(std::string& bytes, std::uint64_t value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}
void Append(std::string& bytes, std::string_view text) {
  Append(bytes, static_cast<std::uint64_t>(text.size()));
  bytes += text;
}

std::string AnswerTo(const Hdf5File& file, char question, const std::string& path,
                     const std::string& name) {
  std::string answer(1, kGood);
  switch (question) {
    case kExists:
      Append(answer, std::uint64_t{file.Exists(path)});
      return answer;
    case kIsGroup:
      Append(answer, std::uint64_t{file.IsGroup(path)});
      return answer;
    case kIsNumeric:
      Append(answer, std::uint64_t{file.IsNumeric(path)});
      return answer;
    case kMembers:
    case kReadTexts:
      for (const std::string& text :
           question == kMembers ? file.Members(path) : file.ReadTexts(path)) {
        Append(answer, text);
      }
      return answer;
    case kShape:
      for (const std::int64_t size : file.Shape(path)) {
        Append(answer, static_cast<std::uint64_t>(size));
      }
      return answer;
    case kRead: {
      const core::Matrix values = file.Read(path);
      Append(answer, static_cast<std::uint64_t>(values.rows()));
      Append(answer, static_cast<std::uint64_t>(values.cols()));
      if (values.size() > 0) {
        answer.append(reinterpret_cast<const char*>(values.data()),
                      static_cast<std::size_t>(values.size()) * sizeof(double));
      }
      return answer;
    }
    case kIntegerAttribute:
      if (const auto value = file.IntegerAttribute(path, name.c_str())) {
        Append(answer, static_cast<std::uint64_t>(*value));
        return answer;
      }
      return std::string(1, kNone);
    case kTextAttribute:
      if (const auto value = file.TextAttribute(path, name.c_str())) {
        Append(answer, *value);
        return answer;
      }
      return std::string(1, kNone);
    default:
      return std::string(1, kError) + "unknown question";
  }
}

// Limits the CPU time from now on to kSeconds plus the time to read a file of this size.
void LimitComputing(std::uint64_t file_size) noexcept {
  rusage used{};
  getrusage(RUSAGE_SELF, &used);
  rlimit limit{};
  getrlimit(RLIMIT_CPU, &limit);
  const rlim_t until = static_cast<rlim_t>(used.ru_utime.tv_sec + used.ru_stime.tv_sec) + kSeconds +
                       file_size / kBytesPerSecond;
  limit.rlim_cur = std::min(limit.rlim_max, until);
  setrlimit(RLIMIT_CPU, &limit);
}

void LimitMemory(std::uint64_t file_size) noexcept {
  // Pages of address space in use: the first number in the file.
  std::uint64_t pages = 0;
  std::ifstream("/proc/self/statm") >> pages;
  const rlim_t used = pages * static_cast<rlim_t>(sysconf(_SC_PAGESIZE));
  const std::uint64_t budget = core::ReadBudget(file_size).left();
  // Values exist twice, because the answer holds a copy. The third budget is a margin.
  const rlim_t most = budget > (RLIM_INFINITY - used - kOverhead) / 3
                          ? RLIM_INFINITY
                          : used + kOverhead + 3 * budget;
  const rlimit limit{most, most};
  setrlimit(RLIMIT_AS, &limit);
}

// Runs the reading process: answers requests until the peer closes the socket.
void Serve(int socket, const std::filesystem::path& path, std::uint64_t file_size) noexcept {
  const auto reply = [socket](const std::string& answer) {
    std::string size;
    Append(size, static_cast<std::uint64_t>(answer.size()));
    return SendAll(socket, size.data(), size.size()) &&
           SendAll(socket, answer.data(), answer.size());
  };
  try {
    std::optional<Hdf5File> file;
    char question = kOpened;
    std::array<std::string, 2> texts;
    do {
      std::string answer;
      LimitComputing(file_size);
      try {
        if (!file) {
          file.emplace(Hdf5File::Open(path));
          // Prevents HDF5 from opening any other file, such as the target of an external link.
          const rlimit none{0, 0};
          setrlimit(RLIMIT_NOFILE, &none);
          answer = std::string(1, kGood);
        } else {
          answer = AnswerTo(*file, question, texts[0], texts[1]);
        }
      } catch (const std::bad_alloc&) {
        answer = std::string(1, kError) + path.string() + ": " + texts[0] +
                 ": needs more memory than a file of this size may request";
      } catch (const std::exception& e) {
        answer = std::string(1, kError) + e.what();
      }
      if (!reply(answer) || !file) return;
      if (!ReceiveAll(socket, &question, 1)) return;
      for (std::string& text : texts) {
        std::uint64_t size = 0;
        if (!ReceiveAll(socket, &size, sizeof size)) return;
        text.resize(size);
        if (!ReceiveAll(socket, text.data(), size)) return;
      }
    } while (true);
  } catch (const std::exception&) {
    return;  // The peer detects the end of the stream.
  }
}

// Resets signal handlers and closes all inherited files except `socket` and the standard streams.
void LeaveBehind(int& socket) noexcept {
  constexpr int kFirst = 3;  // after standard input, output and error
  for (const int signal : {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT, SIGXCPU, SIGALRM, SIGTERM}) {
    std::signal(signal, SIG_DFL);
  }
  std::signal(SIGINT, SIG_IGN);  // meant for the parent process
  const rlimit none{0, 0};
  setrlimit(RLIMIT_CORE, &none);
  if (socket != kFirst) dup2(socket, kFirst);
  socket = kFirst;
  close_range(kFirst + 1, ~0U, 0);
}

}  // namespace

// Reads an answer of the other process piece by piece. The answer is untrusted too.
class Hdf5Reader::Answer {
 public:
  Answer(const Hdf5Reader& reader, std::string path, std::string bytes)
      : reader_(&reader), path_(std::move(path)), bytes_(std::move(bytes)) {}

  [[nodiscard]] bool none() const { return bytes_[0] == kNone; }
  [[nodiscard]] bool done() const { return position_ == bytes_.size(); }

  std::uint64_t Number() {
    std::uint64_t value = 0;
    std::memcpy(&value, Take(sizeof value).data(), sizeof value);
    return value;
  }
  std::string Text() {
    const std::uint64_t size = Number();
    return std::string(Take(size));
  }
  std::string_view Take(std::uint64_t size) {
    if (size > bytes_.size() - position_)
      reader_->Fail(path_, "cannot be read completely: the reading process ended early");
    const std::string_view taken = std::string_view(bytes_).substr(position_, size);
    position_ += size;
    return taken;
  }

 private:
  const Hdf5Reader* reader_;
  std::string path_;
  std::string bytes_;
  std::size_t position_ = 1;
};

Hdf5Reader::Hdf5Reader(const std::filesystem::path& path) : name_(path.string()) {
  core::CheckPlainFile(path);
  std::error_code error;
  file_size_ = std::filesystem::file_size(path, error);
  if (error == std::errc::no_such_file_or_directory) {
    throw std::runtime_error(name_ + ": no such file");
  }
  if (error) throw std::runtime_error(name_ + ": cannot be opened: " + error.message());
  std::array<int, 2> sockets{};
  if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, sockets.data()) != 0) {
    throw std::runtime_error(name_ + ": cannot be read: " + std::strerror(errno));
  }
  process_ = fork();
  if (process_ == 0) {
    LeaveBehind(sockets[1]);
    LimitMemory(file_size_);
    Serve(sockets[1], path, file_size_);
    _exit(0);
  }
  const int reason = errno;
  close(sockets[1]);
  socket_ = sockets[0];
  if (process_ < 0) {
    close(socket_);
    throw std::runtime_error(name_ +
                             ": cannot start a process to read it: " + std::strerror(reason));
  }
  try {
    static_cast<void>(Ask(kOpened, ""));
  } catch (...) {
    Hdf5Reader ended = std::move(*this);
    throw;
  }
}

Hdf5Reader::Hdf5Reader(Hdf5Reader&& other) noexcept
    : name_(std::move(other.name_)),
      file_size_(other.file_size_),
      socket_(std::exchange(other.socket_, -1)),
      process_(std::exchange(other.process_, -1)) {}

Hdf5Reader& Hdf5Reader::operator=(Hdf5Reader&& other) noexcept {
  std::swap(name_, other.name_);
  std::swap(file_size_, other.file_size_);
  std::swap(socket_, other.socket_);
  std::swap(process_, other.process_);
  return *this;
}

Hdf5Reader::~Hdf5Reader() {
  if (socket_ >= 0) close(socket_);
  if (process_ <= 0) return;
  // The process only waits for a request or for libhdf5. It needs no cleanup.
  kill(process_, SIGKILL);
  while (waitpid(process_, nullptr, 0) < 0 && errno == EINTR) {
  }
}

void Hdf5Reader::Fail(const std::string& path, const std::string& reason) const {
  throw std::runtime_error(name_ + ": " + path + ": " + reason);
}

void Hdf5Reader::CheckSize(const std::string& path, std::int64_t rows, std::int64_t cols) const {
  if (rows < 0 || cols < 0 || rows > (std::int64_t{1} << 48) ||
      !core::ReadBudget(file_size_)
           .Take(static_cast<std::uint64_t>(rows) * sizeof(double),
                 static_cast<std::uint64_t>(cols))) {
    Fail(path, "declares " + std::to_string(rows) + " x " + std::to_string(cols) +
                   " entries, too many for a file of this size");
  }
}

void Hdf5Reader::FailDead(const std::string& path) const {
  std::string how = "has ended";
  int status = 0;
  if (process_ > 0) {
    while (waitpid(process_, &status, 0) < 0 && errno == EINTR) {
    }
    process_ = -1;
    if (WIFSIGNALED(status)) {
      const int signal = WTERMSIG(status);
      how = signal == SIGXCPU || signal == SIGKILL
                ? "did not finish reading it"
                : "crashed on it (signal " + std::to_string(signal) + ")";
    }
  }
  throw std::runtime_error(name_ + ": " + (path.empty() ? "" : path + ": ") + "libhdf5 " + how +
                           ": the file is damaged");
}

void Hdf5Reader::Receive(void* bytes, std::size_t size, const std::string& path) const {
  if (!ReceiveAll(socket_, bytes, size)) FailDead(path);
}

Hdf5Reader::Answer Hdf5Reader::Ask(char question, const std::string& path,
                                   std::string_view name) const {
  // The first answer needs no request.
  if (question != kOpened) {
    std::string bytes(1, question);
    Append(bytes, path);
    Append(bytes, name);
    if (process_ <= 0 || !SendAll(socket_, bytes.data(), bytes.size())) FailDead(path);
  }
  std::uint64_t size = 0;
  Receive(&size, sizeof size, path);
  if (size < 1 || !core::ReadBudget(file_size_).Take(size, 1)) {
    Fail(path, "needs more bytes than a file of this size may request");
  }
  std::string bytes(size, '\0');
  Receive(bytes.data(), bytes.size(), path);
  if (bytes[0] == kError) throw std::runtime_error(bytes.substr(1));
  return {*this, path, std::move(bytes)};
}

bool Hdf5Reader::Exists(const std::string& path) const { return Ask(kExists, path).Number() != 0; }

bool Hdf5Reader::IsGroup(const std::string& path) const {
  return Ask(kIsGroup, path).Number() != 0;
}

bool Hdf5Reader::IsNumeric(const std::string& path) const {
  return Ask(kIsNumeric, path).Number() != 0;
}

std::vector<std::string> Hdf5Reader::Members(const std::string& group) const {
  Answer answer = Ask(kMembers, group);
  std::vector<std::string> names;
  while (!answer.done()) names.push_back(answer.Text());
  return names;
}

std::vector<std::string> Hdf5Reader::ReadTexts(const std::string& path) const {
  Answer answer = Ask(kReadTexts, path);
  std::vector<std::string> texts;
  while (!answer.done()) texts.push_back(answer.Text());
  return texts;
}

std::vector<std::int64_t> Hdf5Reader::Shape(const std::string& path) const {
  Answer answer = Ask(kShape, path);
  std::vector<std::int64_t> shape;
  while (!answer.done()) shape.push_back(static_cast<std::int64_t>(answer.Number()));
  return shape;
}

core::Matrix Hdf5Reader::Read(const std::string& path) const {
  Answer answer = Ask(kRead, path);
  const std::uint64_t rows = answer.Number();
  const std::uint64_t cols = answer.Number();
  CheckSize(path, static_cast<std::int64_t>(rows), static_cast<std::int64_t>(cols));
  core::Matrix values(static_cast<Eigen::Index>(rows), static_cast<Eigen::Index>(cols));
  const std::string_view bytes = answer.Take(rows * cols * sizeof(double));
  if (!bytes.empty()) std::memcpy(values.data(), bytes.data(), bytes.size());
  return values;
}

std::optional<std::int64_t> Hdf5Reader::IntegerAttribute(const std::string& path,
                                                         const char* name) const {
  Answer answer = Ask(kIntegerAttribute, path, name);
  if (answer.none()) return std::nullopt;
  return static_cast<std::int64_t>(answer.Number());
}

std::optional<std::string> Hdf5Reader::TextAttribute(const std::string& path,
                                                     const char* name) const {
  Answer answer = Ask(kTextAttribute, path, name);
  if (answer.none()) return std::nullopt;
  return answer.Text();
}

}  // namespace dfr::imitation::internal
