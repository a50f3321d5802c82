#include "dfr/experiment/ledger.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <map>
#include <optional>
#include <stdexcept>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/files/atomic_file.h"
#include "dfr/core/files/read_file.h"
#include "ledger/ledger_line.h"

namespace dfr::experiment {

using internal::Fail;
using internal::Fingerprint;
using internal::HeaderLine;
using internal::IdentityHash;
using internal::KeyOf;
using internal::NameOf;
using internal::UnitLine;

LedgerContents ReadLedger(const std::filesystem::path& path) {
  const std::string text = core::ReadFile(path);
  LedgerContents contents;
  std::optional<internal::LedgerReader> reader;
  try {
    const std::size_t end = internal::ForEachLine(text, [&](std::string_view line, int number) {
      if (number == 1) {
        contents.header = internal::LedgerReader::Header(line);
        reader.emplace(contents.header);
        return;
      }
      try {
        if (auto record = reader->Record(line)) contents.records.push_back(std::move(*record));
      } catch (const std::exception& e) {
        throw std::runtime_error(internal::DamagedLine(number, e));
      }
    });
    contents.cut = end < text.size();
  } catch (const std::exception& e) {
    Fail(path, e.what());
  }
  if (!reader) Fail(path, "is empty: no unit is finished yet");
  return contents;
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
  std::filesystem::path first_path;
  struct Line {
    std::uint64_t fingerprint;
    std::filesystem::path from;
    std::string text;
    std::string instructions;
  };
  std::map<internal::UnitKey, Line> lines;
  for (const std::filesystem::path& path : shards) {
    // A ledger is empty if no unit is finished, or if there are more shards than units.
    if (std::filesystem::exists(path) && std::filesystem::file_size(path) == 0) continue;
    const LedgerContents contents = ReadLedger(path);
    if (!header) {
      header = contents.header;
      header->shard = {};
      first_path = path;
    }
    const std::string difference = Difference(*header, contents.header);
    if (!difference.empty()) {
      Fail(path, "does not belong to " + first_path.string() + ": " + difference +
                     " (now: in this ledger)");
    }
    const std::uint64_t identity = IdentityHash(*header);
    for (const LedgerRecord& record : contents.records) {
      const std::string text = UnitLine(record, identity);
      const EvaluationUnit& unit = record.result.unit;
      const std::uint64_t fingerprint = Fingerprint(record);
      const auto [found, added] =
          lines.try_emplace(KeyOf(unit), Line{fingerprint, path, text, record.instructions});
      if (added) continue;
      if (found->second.fingerprint != fingerprint) {
        Fail(path, "has results of " + NameOf(unit) + " that differ from those in " +
                       found->second.from.string() +
                       "; run one of the two again with the same build and instruction set (" +
                       record.instructions + " here, " + found->second.instructions + " there)");
      }
      // Only times and rounding differ: any order of the shards must give the same file.
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
                             " units are missing; the first is " + first +
                             ". Run their shards again; each resumes where it stopped");
  }
  core::ReplaceFile(whole, text);
}

std::string HashOfFile(const std::filesystem::path& path) {
  return internal::HashText(core::ReadFile(path));
}

std::string Exactly(double value) {
  std::array<char, 32> digits{};
  const auto end = std::to_chars(digits.data(), digits.data() + digits.size(), value);
  return {digits.data(), end.ptr};
}

}  // namespace dfr::experiment
