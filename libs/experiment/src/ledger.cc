#include "ledger.h"

#include <cstddef>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>
#include <system_error>

namespace dfr::experiment::internal {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kFormat = "dfr paired evaluation";
constexpr int kVersion = 1;

Json HeaderOf(const EvaluationPlan& plan, const std::map<std::string, std::string>& settings) {
  Json header = {{"format", kFormat},
                 {"version", kVersion},
                 {"methods", plan.methods},
                 {"learners", plan.learners},
                 {"demonstrations", plan.demonstrations},
                 {"trials", plan.trials},
                 {"episodes", plan.episodes},
                 {"seed", plan.seed}};
  for (const auto& [name, value] : settings) header["settings"][name] = value;
  return header;
}

// Columns instead of one object per episode: a line of 240 episodes stays at a few kB.
Json ToJson(const UnitResult& result) {
  Json episodes = Json::array();
  for (const auto& method : result.episodes) {
    std::string outcomes;
    Json causes = Json::array();
    Json controls = Json::array();
    Json recovery_controls = Json::array();
    Json seconds = Json::array();
    for (const EpisodeResult& episode : method) {
      outcomes += "CHX"[static_cast<int>(episode.outcome)];
      causes.push_back(episode.cause);
      controls.push_back(episode.controls);
      recovery_controls.push_back(episode.recovery_controls);
      seconds.push_back(episode.seconds);
    }
    episodes.push_back({{"outcomes", outcomes},
                        {"causes", causes},
                        {"controls", controls},
                        {"recovery_controls", recovery_controls},
                        {"seconds", seconds}});
  }
  return {{"trial", result.unit.trial},
          {"demonstrations", result.unit.demonstrations},
          {"learner", result.unit.learner},
          {"redrawn", result.redrawn},
          {"starts", result.starts},
          {"measures", result.measures},
          {"episodes", episodes}};
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

UnitResult FromJson(const Json& json, const EvaluationPlan& plan) {
  UnitResult result;
  result.unit.trial = json.at("trial");
  result.unit.demonstrations = json.at("demonstrations");
  result.unit.learner = json.at("learner");
  result.redrawn = json.at("redrawn");
  result.starts = json.at("starts").get<std::vector<std::uint64_t>>();
  result.measures = json.at("measures").get<std::map<std::string, double>>();
  const auto count = static_cast<std::size_t>(plan.episodes);
  for (const Json& method : json.at("episodes")) {
    const auto outcomes = method.at("outcomes").get<std::string>();
    if (outcomes.size() != count) throw std::runtime_error("it has another number of episodes");
    auto& episodes = result.episodes.emplace_back();
    for (std::size_t i = 0; i < count; ++i) {
      episodes.push_back({OutcomeOf(outcomes[i]), method.at("causes").at(i),
                          method.at("controls").at(i), method.at("recovery_controls").at(i),
                          method.at("seconds").at(i)});
    }
  }
  if (result.episodes.size() != plan.methods.size()) {
    throw std::runtime_error("it has another number of methods");
  }
  return result;
}

// The first entry in which two objects differ, with both values.
std::string Difference(const Json& there, const Json& here, const std::string& prefix) {
  Json all = there;
  all.update(here);
  for (const auto& [name, unused] : all.items()) {
    const Json a = there.value(name, Json());
    const Json b = here.value(name, Json());
    if (a == b) continue;
    if (a.is_object() && b.is_object()) return Difference(a, b, name + ".");
    return prefix + name + " is " + a.dump() + " there and " + b.dump() + " now";
  }
  return "";
}

}  // namespace

Ledger::Ledger(const std::filesystem::path& path, const EvaluationPlan& plan,
               const std::map<std::string, std::string>& settings)
    : path_(path) {
  const auto fail = [&](const std::string& reason) {
    throw std::runtime_error(path.string() + ": " + reason);
  };
  const Json header = HeaderOf(plan, settings);
  std::string text;
  if (std::filesystem::exists(path)) {
    std::ifstream in(path, std::ios::binary);
    std::ostringstream bytes;
    bytes << in.rdbuf();
    if (!in) fail("cannot be read");
    text = bytes.str();
  }
  // Units are appended with their line's end in one write, so only a last line can be incomplete.
  const std::size_t complete = text.rfind('\n') == std::string::npos ? 0 : text.rfind('\n') + 1;
  std::istringstream lines(text.substr(0, complete));
  std::string line;
  int number = 0;
  while (std::getline(lines, line)) {
    ++number;
    const Json json = Json::parse(line, nullptr, /*allow_exceptions=*/false);
    if (number == 1) {
      if (!json.is_object() || json.value("format", "") != kFormat) {
        fail("is not a ledger of a paired evaluation; choose another directory");
      }
      if (json != header) {
        fail("was begun with other settings: " + Difference(json, header, "") +
             ". Choose another directory, or delete this file to begin anew");
      }
      continue;
    }
    try {
      UnitResult result = FromJson(json, plan);
      for (const UnitResult& other : finished_) {
        if (other.unit == result.unit) throw std::runtime_error("it repeats an earlier unit");
      }
      finished_.push_back(std::move(result));
    } catch (const std::exception& e) {
      fail("line " + std::to_string(number) + " is damaged: " + e.what() +
           ". Delete that line to run its unit again");
    }
  }
  if (complete < text.size()) std::filesystem::resize_file(path, complete);
  file_.open(path, std::ios::binary | std::ios::app);
  if (number == 0) file_ << header.dump() + "\n" << std::flush;
  if (!file_) fail("cannot be written");
}

void Ledger::Append(const UnitResult& result) {
  file_ << ToJson(result).dump() + "\n" << std::flush;
  if (!file_) throw std::runtime_error(path_.string() + ": cannot be written; is the disk full?");
}

}  // namespace dfr::experiment::internal
