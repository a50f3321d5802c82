#include "ledger/ledger_line.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <vector>

#include "dfr/core/text/format.h"

namespace dfr::experiment::internal {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kFormat = "dfr paired evaluation";
constexpr int kVersion = 2;
constexpr std::string_view kCheckKey = ",\"check\":\"";
constexpr std::size_t kCheckSize = 10 + 16 + 2;  // key, digits, "}
constexpr const char* kDamagedHeader =
    "line 1 is damaged: its checksum does not match. Run the same command with --salvage to write "
    "it again";
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

// Returns true for a header line, even with damage at one place: the line begins or ends like a
// header.
bool IsOfLedger(std::string_view line) {
  return line.starts_with(std::string("{\"format\":\"") + kFormat + '"') ||
         (line.size() > kCheckSize && line.substr(line.size() - kCheckSize).starts_with(kCheckKey));
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

// Returns the entries that must be equal in two ledgers with the same results.
Json IdentityOf(const LedgerHeader& header) {
  const EvaluationPlan& plan = header.plan;
  Json json = {{"format", kFormat},
               {"version", kVersion},
               {"methods", plan.methods},
               {"learners", plan.learners},
               {"demonstrations", plan.demonstrations},
               {"trials", plan.trials},
               {"episodes", plan.episodes},
               {"seed", plan.seed},
               {"settings", header.settings},
               {"commit", header.commit}};
  // Ledgers of earlier versions have only the default.
  if (plan.max_redraws != EvaluationPlan().max_redraws) json["max_redraws"] = plan.max_redraws;
  return json;
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
          {"finished", record.finished},
          {"instructions", record.instructions}};
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
    throw std::runtime_error("its number of start states differs from the plan's");
  }
  int left = result.redrawn;
  for (int i = 0; i < plan.episodes; ++i) {
    const std::uint64_t start = result.starts[static_cast<std::size_t>(i)];
    int attempt = 0;
    while (StartSeed(plan, result.unit.trial, i, attempt) != start) {
      if (attempt >= std::min(left, plan.max_redraws - 1)) {
        throw std::runtime_error("its start states belong to another seed");
      }
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
    // JSON has no NaN: null stands for it.
    result.measures[name] =
        value.is_null() ? std::numeric_limits<double>::quiet_NaN() : value.get<double>();
  }
  json.at("counts").get_to(result.counts);
  record.host = json.at("host");
  record.wall_s = json.at("wall_s");
  record.finished = json.at("finished");
  record.instructions = json.value("instructions", "unknown");
  CheckUnit(result.unit, plan);
  CheckStarts(result, plan);
  const auto count = static_cast<std::size_t>(plan.episodes);
  for (const Json& method : json.at("episodes")) {
    const auto outcomes = method.at("outcomes").get<std::string>();
    if (outcomes.size() != count)
      throw std::runtime_error("its number of episodes differs from the plan's");
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
    throw std::runtime_error("its number of methods differs from the plan's");
  }
  return record;
}

// Rounds 1 + |value| to 30 binary digits: instruction sets differ in the last bits.
double RoundedResult(double value) {
  int exponent = 0;
  const double mantissa = std::frexp(1.0 + std::abs(value), &exponent);
  return std::copysign(std::ldexp(std::round(std::ldexp(mantissa, 30)), exponent - 30), value);
}

// Returns the entries that must be equal in two runs of one unit.
UnitResult Comparable(UnitResult result) {
  for (auto& method : result.episodes) {
    for (EpisodeResult& episode : method) {
      episode.seconds = 0.0;
      episode.change = RoundedResult(episode.change);
    }
  }
  for (auto& [name, value] : result.measures) value = RoundedResult(value);
  return result;
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

}  // namespace

std::string NameOf(const EvaluationUnit& unit) {
  return "trial " + std::to_string(unit.trial) + ", " + std::to_string(unit.demonstrations) +
         " demonstrations, " + unit.learner;
}

std::string TextOf(const Shard& shard) {
  return std::to_string(shard.index) + "/" + std::to_string(shard.count);
}

std::string HashText(std::string_view bytes) { return Hex(Hash(bytes, 0)); }

std::uint64_t IdentityHash(const LedgerHeader& header) {
  return Hash(IdentityOf(header).dump(), 0);
}

std::string HeaderLine(const LedgerHeader& header) {
  Json json = IdentityOf(header);
  json["shard"] = TextOf(header.shard);
  return WithCheck(json, 0);
}

std::uint64_t Fingerprint(const LedgerRecord& record) {
  LedgerRecord bare;
  bare.result = Comparable(record.result);
  return Hash(ToJson(bare).dump(), 0);
}

std::string UnitLine(const LedgerRecord& record, std::uint64_t identity) {
  return WithCheck(ToJson(record), identity);
}

LedgerHeader LedgerReader::Header(std::string_view line) {
  const Json json = Parse(line);
  const auto format = json.is_object() ? json.find("format") : json.end();
  if (!json.is_object() || format == json.end() || !format->is_string() ||
      format->get_ref<const std::string&>() != kFormat) {
    if (IsOfLedger(line)) throw std::runtime_error(kDamagedHeader);
    throw std::runtime_error("is not a ledger of a paired evaluation; choose another folder");
  }
  const Json version = json.value("version", Json());
  if (!version.is_number() && IsOfLedger(line)) throw std::runtime_error(kDamagedHeader);
  if (version != kVersion) {
    throw std::runtime_error("is a ledger of format version " + version.dump() + ", which " +
                             (version.is_number() && version < kVersion ? "an older" : "another") +
                             " dfr wrote; this one writes version " + std::to_string(kVersion) +
                             ". Choose another folder, or start over with --restart");
  }
  if (!CheckHolds(line, 0)) throw std::runtime_error(kDamagedHeader);
  LedgerHeader header;
  try {
    json.at("methods").get_to(header.plan.methods);
    json.at("learners").get_to(header.plan.learners);
    json.at("demonstrations").get_to(header.plan.demonstrations);
    header.plan.trials = json.at("trials");
    header.plan.episodes = json.at("episodes");
    header.plan.seed = json.at("seed");
    header.plan.max_redraws = json.value("max_redraws", header.plan.max_redraws);
    json.at("settings").get_to(header.settings);
    header.commit = json.at("commit");
    header.shard = ParseShard(json.at("shard").get<std::string>());
  } catch (const std::exception& e) {
    throw std::runtime_error(std::string("line 1 is damaged: ") + e.what());
  }
  return header;
}

LedgerReader::LedgerReader(const LedgerHeader& header)
    : plan_(&header.plan), identity_(IdentityHash(header)) {}

std::optional<LedgerRecord> LedgerReader::Record(std::string_view line) {
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

}  // namespace dfr::experiment::internal

namespace dfr::experiment {

std::string Difference(const LedgerHeader& there, const LedgerHeader& now) {
  return internal::DifferenceOf(internal::IdentityOf(there), internal::IdentityOf(now), "");
}

}  // namespace dfr::experiment
