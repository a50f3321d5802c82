#include "ledger/ledger_file.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <string_view>
#include <system_error>

#include "dfr/core/files/read_file.h"
#include "ledger/ledger_line.h"

namespace dfr::experiment::internal {
namespace {

// BuildCommit() of a build outside a git repository.
constexpr std::string_view kUnknownCommit = "unknown";

void WriteAll(int file, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t written = write(file, bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) throw std::system_error(errno, std::generic_category());
    bytes.remove_prefix(static_cast<std::size_t>(written));
  }
}

std::int64_t NowSeconds() {
  return std::chrono::duration_cast<std::chrono::seconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

std::string Quoted(const Shard& shard) { return '"' + TextOf(shard) + '"'; }

}  // namespace

Descriptor::~Descriptor() {
  if (descriptor_ >= 0) close(descriptor_);
}

Descriptor OpenLocked(const std::filesystem::path& path) {
  for (;;) {
    Descriptor file(open(path.c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC, 0666));
    if (file.get() < 0) {
      Fail(path, std::string("cannot be written: ") + std::strerror(errno) +
                     "; check that the folder exists and is writable");
    }
    if (flock(file.get(), LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK) {
      Fail(path, "another process is writing it; wait for it to finish, or choose another --out");
    }
    // Between open and lock, the lock's previous holder may have replaced the file.
    struct stat opened {};
    struct stat present {};
    if (fstat(file.get(), &opened) == 0 && stat(path.c_str(), &present) == 0 &&
        opened.st_ino == present.st_ino && opened.st_dev == present.st_dev) {
      return file;
    }
  }
}

bool IsLocked(const std::filesystem::path& path) {
  const Descriptor file(open(path.c_str(), O_RDWR | O_CLOEXEC));
  return file.get() >= 0 && flock(file.get(), LOCK_SH | LOCK_NB) != 0 && errno == EWOULDBLOCK;
}

LedgerWriter::LedgerWriter(const std::filesystem::path& path, const LedgerHeader& header,
                           const EvaluationOptions& options)
    : path_(path),
      header_line_(HeaderLine(header)),
      identity_(IdentityHash(header)),
      file_(OpenLocked(path)) {
  const auto notice = [&](const std::string& text) {
    if (options.notice) options.notice(path.string() + ": " + text);
  };
  const std::string text = core::ReadFile(path);
  LedgerReader reader(header);
  std::string kept = header_line_;
  std::string dropped;
  const std::size_t complete = ForEachLine(text, [&](std::string_view line, int number) {
    try {
      if (number == 1) {
        const LedgerHeader there = LedgerReader::Header(line);
        std::string difference = Difference(there, header);
        if (difference.empty() && there.shard != header.shard) {
          difference =
              "shard is " + Quoted(there.shard) + " there and " + Quoted(header.shard) + " now";
        }
        if (!difference.empty()) {
          Fail(path, "was begun with other settings: " + difference +
                         ". Choose another folder, or start over with --restart");
        }
        return;
      }
      if (auto record = reader.Record(line)) finished_.push_back(std::move(*record));
      kept.append(line) += '\n';
    } catch (const std::exception& e) {
      const bool damaged_header = number == 1 && std::string_view(e.what()).starts_with("line 1");
      if (!options.salvage || (number == 1 && !damaged_header)) {
        if (number == 1 && std::string_view(e.what()).starts_with(path.string())) throw;
        Fail(path, number == 1 ? e.what() : DamagedLine(number, e));
      }
      notice("line " + std::to_string(number) + " is dropped: " + e.what());
      dropped.append(line) += '\n';
    }
  });
  size_ = complete;
  if (header.commit == kUnknownCommit && !finished_.empty()) {
    notice(
        "neither the build that wrote these units nor this build knows its commit, so a change of "
        "the code would go unnoticed. If the code has changed, start over with --restart");
  }
  if (complete < text.size()) {
    notice(
        "the last line is incomplete and is dropped: its writer was killed. Its unit runs again");
  }
  if (!dropped.empty()) {
    std::filesystem::path aside = path;
    aside += ".dropped";
    const Descriptor file(open(aside.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666));
    try {
      if (file.get() < 0) throw std::system_error(errno, std::generic_category());
      WriteAll(file.get(), dropped);
    } catch (const std::system_error& e) {
      Fail(aside, std::string("cannot be written: ") + e.code().message());
    }
    std::filesystem::path temporary = path;
    temporary += ".part";
    std::filesystem::remove(temporary);
    Descriptor whole = OpenLocked(temporary);
    try {
      WriteAll(whole.get(), kept);
      if (fsync(whole.get()) != 0) throw std::system_error(errno, std::generic_category());
    } catch (const std::system_error& e) {
      Fail(temporary, std::string("cannot be written: ") + e.code().message());
    }
    std::filesystem::rename(temporary, path);
    file_ = std::move(whole);
    size_ = kept.size();
  } else if (complete < text.size() && ftruncate(file_.get(), static_cast<off_t>(complete)) != 0) {
    Fail(path,
         std::string("cannot be truncated after its last complete line: ") + std::strerror(errno));
  }
}

void LedgerWriter::Write(const std::string& line) {
  try {
    WriteAll(file_.get(), line);
    // One sync per second is cheap. A power failure loses at most the lines of one second.
    if (const std::int64_t now = NowSeconds(); now != last_sync_) {
      if (fdatasync(file_.get()) != 0) throw std::system_error(errno, std::generic_category());
      last_sync_ = now;
    }
  } catch (const std::system_error& e) {
    // Removes the partial line. After another failure, the next run removes the line.
    static_cast<void>(ftruncate(file_.get(), static_cast<off_t>(size_)) == 0);
    Fail(path_, "cannot be written: " + e.code().message() +
                    ". Earlier units are kept; the same command resumes from there");
  }
  size_ += line.size();
}

void LedgerWriter::Append(const LedgerRecord& record) {
  if (size_ == 0) Write(header_line_);
  Write(UnitLine(record, identity_));
}

}  // namespace dfr::experiment::internal
