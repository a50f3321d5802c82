#include "dfr/experiment/ledger.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <system_error>
#include <tuple>

#include "dfr/core/contract.h"
#include "dfr/core/format.h"
#include "dfr/core/random.h"
#include "ledger_file.h"
#include "text_file.h"

namespace dfr::experiment {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kFormat = "dfr paired evaluation";
constexpr int kVersion = 2;
constexpr std::string_view kCheckKey = ",\"check\":\"";
constexpr std::size_t kCheckSize = 10 + 16 + 2;  // key, digits, "}
constexpr int kDeepest = 100;  // maximum nesting of brackets in a line, including those in names

// FNV-1a, followed by a mixing of bits. Every step is one-to-one; any change of a single byte is
// therefore detected.
std::uint64_t Hash(std::string_view bytes, std::uint64_t seed) {
  std::uint64_t hash = 0xcbf29ce484222325u ^ seed;
  for (const char byte : bytes) {
    hash = (hash ^ static_cast<unsigned char>(byte)) * 0x100000001b3u;
  }
  hash = (hash ^ (hash >> 32)) * 0xd6e8feb86659fd93u;
  return hash ^ (hash >> 32);
}

std::string Hex(std::uint64_t value) {
  return core::Format("%016llx", static_cast<unsigned long long>(value));
}

std::string WithCheck(const Json& json, std::uint64_t seed) {
  std::string line = json.dump();
  line.pop_back();  // the closing brace
  const std::string check = Hex(Hash(line, seed));
  return line.append(kCheckKey).append(check).append("\"}\n");
}

bool CheckHolds(std::string_view line, std::uint64_t seed) {
  if (line.size() < kCheckSize) return false;
  const std::string_view body = line.substr(0, line.size() - kCheckSize);
  const std::string_view tail = line.substr(body.size());
  return tail.starts_with(kCheckKey) && tail.ends_with("\"}") &&
         tail.substr(kCheckKey.size(), 16) == Hex(Hash(body, seed));
}

// Returns a discarded value for invalid JSON, or for JSON nested deeper than a ledger.
Json Parse(std::string_view line) {
  bool too_deep = false;
  for (int depth = 0; const char c : line) {
    depth += c == '[' || c == '{' ? 1 : c == ']' || c == '}' ? -1 : 0;
    too_deep = too_deep || depth > kDeepest;
  }
  if (too_deep) return Json(Json::value_t::discarded);
  return Json::parse(line.begin(), line.end(), nullptr, /*allow_exceptions=*/false);
}

Json ShardOf(const Shard& shard) {
  return std::to_string(shard.index) + "/" + std::to_string(shard.count);
}

// Returns the entries that must be equal in two ledgers with the same results.
Json IdentityOf(const LedgerHeader& header) {
  const EvaluationPlan& plan = header.plan;
  return {{"format", kFormat},
          {"version", kVersion},
          {"methods", plan.methods},
          {"learners", plan.learners},
          {"demonstrations", plan.demonstrations},
          {"trials", plan.trials},
          {"episodes", plan.episodes},
          {"seed", plan.seed},
          {"settings", header.settings},
          {"commit", header.commit}};
}

std::uint64_t IdentityHash(const LedgerHeader& header) {
  return Hash(IdentityOf(header).dump(), 0);
}

std::string HeaderLine(const LedgerHeader& header) {
  Json json = IdentityOf(header);
  json["shard"] = ShardOf(header.shard);
  return WithCheck(json, 0);
}

// Uses columns instead of one object per episode: a line of 240 episodes takes only a few kB.
Json ToJson(const LedgerRecord& record) {
  const UnitResult& result = record.result;
  Json episodes = Json::array();
  for (const auto& method : result.episodes) {
    std::string outcomes;
    Json causes = Json::array();
    Json controls = Json::array();
    Json recovery_controls = Json::array();
    Json changed_controls = Json::array();
    Json seconds = Json::array();
    Json changes = Json::array();
    Json sized_changes = Json::array();
    for (const EpisodeResult& episode : method) {
      outcomes += "CHX"[static_cast<int>(episode.outcome)];
      causes.push_back(episode.cause);
      controls.push_back(episode.controls);
      recovery_controls.push_back(episode.recovery_controls);
      changed_controls.push_back(episode.changed_controls);
      seconds.push_back(episode.seconds);
      changes.push_back(episode.change);
      sized_changes.push_back(episode.sized_changes);
    }
    episodes.push_back({{"outcomes", outcomes},
                        {"causes", causes},
                        {"controls", controls},
                        {"recovery_controls", recovery_controls},
                        {"changed_controls", changed_controls},
                        {"seconds", seconds},
                        {"changes", changes},
                        {"sized_changes", sized_changes}});
  }
  return {{"trial", result.unit.trial},
          {"demonstrations", result.unit.demonstrations},
          {"learner", result.unit.learner},
          {"redrawn", result.redrawn},
          {"starts", result.starts},
          {"measures", result.measures},
          {"counts", result.counts},
          {"episodes", episodes},
          {"host", record.host},
          {"wall_s", record.wall_s},
          {"finished", record.finished}};
}

core::Outcome OutcomeOf(char letter) {
  switch (letter) {
    case 'C':
      return core::Outcome::kCompleted;
    case 'H':
      return core::Outcome::kHalted;
    case 'X':
      return core::Outcome::kCollided;
    default:
      throw std::runtime_error(std::string("no outcome has the letter ") + letter);
  }
}

// Checks that the start states follow from the seed, as Evaluate() draws them.
void CheckStarts(const UnitResult& result, const EvaluationPlan& plan) {
  if (std::ssize(result.starts) != plan.episodes) {
    throw std::runtime_error("its number of start states differs");
  }
  int left = result.redrawn;
  for (int i = 0; i < plan.episodes; ++i) {
    const std::uint64_t start = result.starts[static_cast<std::size_t>(i)];
    int attempt = 0;
    while (StartSeed(plan, result.unit.trial, i, attempt) != start) {
      if (attempt == left) throw std::runtime_error("its start states belong to another seed");
      ++attempt;
    }
    left -= attempt;
  }
  if (left != 0) throw std::runtime_error("its start states belong to another seed");
}

void CheckUnit(const EvaluationUnit& unit, const EvaluationPlan& plan) {
  if (unit.trial < 0 || unit.trial >= plan.trials ||
      std::ranges::find(plan.demonstrations, unit.demonstrations) == plan.demonstrations.end() ||
      std::ranges::find(plan.learners, unit.learner) == plan.learners.end()) {
    throw std::runtime_error("its unit is not in the plan");
  }
}

LedgerRecord RecordFrom(const Json& json, const EvaluationPlan& plan) {
  LedgerRecord record;
  UnitResult& result = record.result;
  result.unit.trial = json.at("trial");
  result.unit.demonstrations = json.at("demonstrations");
  result.unit.learner = json.at("learner");
  result.redrawn = json.at("redrawn");
  result.starts = json.at("starts").get<std::vector<std::uint64_t>>();
  for (const auto& [name, value] : json.at("measures").items()) {
    // JSON has no NaN.
    result.measures[name] =
        value.is_null() ? std::numeric_limits<double>::quiet_NaN() : value.get<double>();
  }
  json.at("counts").get_to(result.counts);
  record.host = json.at("host");
  record.wall_s = json.at("wall_s");
  record.finished = json.at("finished");
  CheckUnit(result.unit, plan);
  CheckStarts(result, plan);
  const auto count = static_cast<std::size_t>(plan.episodes);
  for (const Json& method : json.at("episodes")) {
    const auto outcomes = method.at("outcomes").get<std::string>();
    if (outcomes.size() != count) throw std::runtime_error("its number of episodes differs");
    auto& episodes = result.episodes.emplace_back();
    episodes.reserve(count);
    for (std::size_t i = 0; i < count; ++i) {
      episodes.push_back({OutcomeOf(outcomes[i]), method.at("causes").at(i),
                          method.at("controls").at(i), method.at("recovery_controls").at(i),
                          method.at("changed_controls").at(i), method.at("seconds").at(i),
                          method.at("changes").at(i), method.at("sized_changes").at(i)});
    }
  }
  if (result.episodes.size() != plan.methods.size()) {
    throw std::runtime_error("its number of methods differs");
  }
  return record;
}

// Returns the entries that must be equal in two runs of one unit.
UnitResult WithoutTimes(UnitResult result) {
  for (auto& method : result.episodes) {
    for (EpisodeResult& episode : method) episode.seconds = 0.0;
  }
  return result;
}

auto KeyOf(const EvaluationUnit& unit) {
  return std::tuple(unit.trial, unit.demonstrations, unit.learner);
}
using Key = std::tuple<int, int, std::string>;

std::string NameOf(const EvaluationUnit& unit) {
  return "trial " + std::to_string(unit.trial) + ", " + std::to_string(unit.demonstrations) +
         " demonstrations, " + unit.learner;
}

// Returns the first entry in which two objects differ, with both values.
std::string DifferenceOf(const Json& there, const Json& here, const std::string& prefix) {
  Json all = there;
  all.update(here);
  for (const auto& [name, unused] : all.items()) {
    const Json a = there.value(name, Json());
    const Json b = here.value(name, Json());
    if (a == b) continue;
    if (a.is_object() && b.is_object()) return DifferenceOf(a, b, name + ".");
    return prefix + name + " is " + a.dump() + " there and " + b.dump() + " now";
  }
  return "";
}

// Reads lines and accumulates units. Error texts omit the file's name.
class Reader {
 public:
  // Reads the header line. @throws with the reason and the remedy.
  static LedgerHeader Header(std::string_view line) {
    const Json json = Parse(line);
    const auto format = json.is_object() ? json.find("format") : json.end();
    if (!json.is_object() || format == json.end() || *format != kFormat) {
      throw std::runtime_error("is not a ledger of a paired evaluation; choose another folder");
    }
    const Json version = json.value("version", Json());
    if (version != kVersion) {
      throw std::runtime_error(
          "is a ledger of format version " + version.dump() + ", which " +
          (version.is_number() && version < kVersion ? "an older" : "another") +
          " dfr wrote; this one writes version " + std::to_string(kVersion) +
          ". Choose another folder, or start over with --restart");
    }
    if (!CheckHolds(line, 0)) {
      throw std::runtime_error(
          "line 1 is damaged: its checksum does not match. Run the same command with --salvage to "
          "write it again");
    }
    LedgerHeader header;
    try {
      json.at("methods").get_to(header.plan.methods);
      json.at("learners").get_to(header.plan.learners);
      json.at("demonstrations").get_to(header.plan.demonstrations);
      header.plan.trials = json.at("trials");
      header.plan.episodes = json.at("episodes");
      header.plan.seed = json.at("seed");
      json.at("settings").get_to(header.settings);
      header.commit = json.at("commit");
      header.shard = ParseShard(json.at("shard").get<std::string>());
    } catch (const std::exception& e) {
      throw std::runtime_error(std::string("line 1 is damaged: ") + e.what());
    }
    return header;
  }

  explicit Reader(const LedgerHeader& header)
      : plan_(&header.plan), identity_(IdentityHash(header)) {}

  // Reads the line of a unit; returns std::nullopt if it repeats an earlier unit with the same
  // results.
  std::optional<LedgerRecord> Record(std::string_view line) {
    if (!CheckHolds(line, identity_)) {
      throw std::runtime_error("its checksum does not match, or it belongs to another run");
    }
    LedgerRecord record = RecordFrom(Parse(line), *plan_);
    const auto [found, added] = units_.try_emplace(KeyOf(record.result.unit), Fingerprint(record));
    if (added) return record;
    if (found->second != Fingerprint(record)) {
      throw std::runtime_error("it repeats an earlier unit with different results");
    }
    return std::nullopt;
  }

 private:
  static std::uint64_t Fingerprint(const LedgerRecord& record) {
    LedgerRecord bare;
    bare.result = WithoutTimes(record.result);
    return Hash(ToJson(bare).dump(), 0);
  }

  const EvaluationPlan* plan_;
  std::uint64_t identity_;
  std::map<Key, std::uint64_t> units_;
};

// Calls `use` for each complete line with its number from 1, and returns the end of the last one.
std::size_t ForEachLine(std::string_view text,
                        const std::function<void(std::string_view, int)>& use) {
  std::size_t begin = 0;
  for (int number = 1;; ++number) {
    const std::size_t end = text.find('\n', begin);
    if (end == std::string_view::npos) return begin;
    use(text.substr(begin, end - begin), number);
    begin = end + 1;
  }
}

std::string DamagedLine(int number, const std::exception& e) {
  return "line " + std::to_string(number) + " is damaged: " + e.what() +
         ". Run the same command with --salvage: it moves the line to a separate file and runs its "
         "unit again";
}

[[noreturn]] void Fail(const std::filesystem::path& path, const std::string& reason) {
  throw std::runtime_error(path.string() + ": " + reason);
}

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

}  // namespace

LedgerContents ReadLedger(const std::filesystem::path& path) {
  const std::string text = internal::ReadFile(path);
  LedgerContents contents;
  std::optional<Reader> reader;
  try {
    const std::size_t end = ForEachLine(text, [&](std::string_view line, int number) {
      if (number == 1) {
        contents.header = Reader::Header(line);
        reader.emplace(contents.header);
        return;
      }
      try {
        if (auto record = reader->Record(line)) contents.records.push_back(std::move(*record));
      } catch (const std::exception& e) {
        throw std::runtime_error(DamagedLine(number, e));
      }
    });
    contents.cut = end < text.size();
  } catch (const std::exception& e) {
    Fail(path, e.what());
  }
  if (!reader) Fail(path, "is empty: no unit is finished yet");
  return contents;
}

std::string Difference(const LedgerHeader& there, const LedgerHeader& now) {
  return DifferenceOf(IdentityOf(there), IdentityOf(now), "");
}

std::vector<EvaluationUnit> UnitsOf(const EvaluationPlan& plan) {
  std::vector<EvaluationUnit> units;
  units.reserve(static_cast<std::size_t>(plan.trials) * plan.demonstrations.size() *
                plan.learners.size());
  for (int trial = 0; trial < plan.trials; ++trial) {
    for (const int demonstrations : plan.demonstrations) {
      for (const std::string& learner : plan.learners) {
        units.push_back({trial, demonstrations, learner});
      }
    }
  }
  return units;
}

void MergeLedgers(const std::vector<std::filesystem::path>& shards,
                  const std::filesystem::path& whole) {
  DFR_THROW_UNLESS(!shards.empty(), "no ledger to merge was given");
  std::optional<LedgerHeader> header;
  struct Line {
    std::uint64_t fingerprint;
    std::filesystem::path from;
    std::string text;
  };
  std::map<Key, Line> lines;
  for (const std::filesystem::path& path : shards) {
    // A shard without a finished unit, or one of more shards than units.
    if (std::filesystem::exists(path) && std::filesystem::file_size(path) == 0) continue;
    LedgerContents contents = ReadLedger(path);
    if (!header) {
      header = contents.header;
      header->shard = {};
    }
    const std::string difference = Difference(*header, contents.header);
    if (!difference.empty()) {
      Fail(path, "does not belong to " + shards.front().string() + ": " + difference +
                     " (there: the latter, now: the former)");
    }
    const std::uint64_t identity = IdentityHash(*header);
    for (LedgerRecord& record : contents.records) {
      std::string text = WithCheck(ToJson(record), identity);
      const EvaluationUnit unit = record.result.unit;
      record = {.result = WithoutTimes(std::move(record.result)),
                .host = "",
                .wall_s = 0.0,
                .finished = 0};
      const std::uint64_t fingerprint = Hash(ToJson(record).dump(), 0);
      const auto [found, added] = lines.try_emplace(KeyOf(unit), Line{fingerprint, path, text});
      if (added) continue;
      if (found->second.fingerprint != fingerprint) {
        Fail(path, "has results of " + NameOf(unit) + " that differ from those in " +
                       found->second.from.string() +
                       "; run one of the two again with the same build");
      }
      // Only times differ: any order of the shards must give the same file.
      found->second.text = std::min(found->second.text, text);
    }
  }
  if (!header) Fail(shards.front(), "no unit is finished yet in any shard");
  const std::vector<EvaluationUnit> units = UnitsOf(header->plan);
  std::string text = HeaderLine(*header);
  std::size_t missing = 0;
  std::string first;
  for (const EvaluationUnit& unit : units) {
    const auto found = lines.find(KeyOf(unit));
    if (found != lines.end()) {
      text += found->second.text;
      lines.erase(found);
    } else if (missing++ == 0) {
      first = NameOf(unit);
    }
  }
  if (missing > 0) {
    throw std::runtime_error(std::to_string(missing) + " of " + std::to_string(units.size()) +
                             " units are missing, the first is " + first +
                             ". Run their shards again; each resumes where it stopped");
  }
  internal::ReplaceFile(whole, text);
}

std::string HashOfFile(const std::filesystem::path& path) {
  return Hex(Hash(internal::ReadFile(path), 0));
}

std::string Exactly(double value) {
  std::array<char, 32> digits{};
  const auto end = std::to_chars(digits.data(), digits.data() + digits.size(), value);
  return {digits.data(), end.ptr};
}

namespace internal {

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
  const std::string text = ReadFile(path);
  Reader reader(header);
  std::string kept = header_line_;
  std::string dropped;
  const std::size_t complete = ForEachLine(text, [&](std::string_view line, int number) {
    try {
      if (number == 1) {
        const LedgerHeader there = Reader::Header(line);
        std::string difference = Difference(there, header);
        if (difference.empty() && there.shard != header.shard) {
          difference = "shard is " + ShardOf(there.shard).dump() + " there and " +
                       ShardOf(header.shard).dump() + " now";
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
  if (complete < text.size()) {
    notice(
        "the last line is incomplete and is dropped: its writer was killed. Its unit runs again");
  }
  if (!dropped.empty()) {
    std::filesystem::path aside = path;
    aside += ".dropped";
    const Descriptor file(open(aside.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666));
    try {
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
    // One sync per second is cheap. A power failure loses at most the last second.
    if (const std::int64_t now = NowSeconds(); now != last_sync_) {
      if (fdatasync(file_.get()) != 0) throw std::system_error(errno, std::generic_category());
      last_sync_ = now;
    }
  } catch (const std::system_error& e) {
    // Remove the partial line; if this fails too, the next run removes it.
    static_cast<void>(ftruncate(file_.get(), static_cast<off_t>(size_)) == 0);
    Fail(path_, "cannot be written: " + e.code().message() +
                    ". Earlier units are kept; the same command resumes from there");
  }
  size_ += line.size();
}

void LedgerWriter::Append(const LedgerRecord& record) {
  if (size_ == 0) Write(header_line_);
  Write(WithCheck(ToJson(record), identity_));
}

}  // namespace internal
}  // namespace dfr::experiment
