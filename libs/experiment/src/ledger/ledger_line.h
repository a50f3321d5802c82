#pragma once

#include <cstddef>
#include <cstdint>
#include <exception>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <tuple>

#include "dfr/experiment/ledger.h"

/// Lines of a ledger: the header's line and one line per unit, each with its checksum.
namespace dfr::experiment::internal {

using UnitKey = std::tuple<int, int, std::string>;
inline UnitKey KeyOf(const EvaluationUnit& unit) {
  return {unit.trial, unit.demonstrations, unit.learner};
}
/// Names a unit in an error text.
[[nodiscard]] std::string NameOf(const EvaluationUnit& unit);
[[nodiscard]] std::string TextOf(const Shard& shard);

/// Returns a hash of the bytes as 16 hexadecimal digits.
[[nodiscard]] std::string HashText(std::string_view bytes);
/// Returns a hash of all values that must be equal in two ledgers with the same results.
[[nodiscard]] std::uint64_t IdentityHash(const LedgerHeader& header);
/// Returns a hash of a unit's results, without times. Real numbers are rounded to 9 digits.
[[nodiscard]] std::uint64_t Fingerprint(const LedgerRecord& record);

[[nodiscard]] std::string HeaderLine(const LedgerHeader& header);
[[nodiscard]] std::string UnitLine(const LedgerRecord& record, std::uint64_t identity);

/// Reads lines and accumulates units. Error texts omit the file's name.
class LedgerReader {
 public:
  /// Reads the header line. @throws std::runtime_error with the reason and the remedy.
  static LedgerHeader Header(std::string_view line);

  explicit LedgerReader(const LedgerHeader& header);

  /// Reads the line of a unit; returns std::nullopt if it repeats an earlier unit with the same
  /// results. @throws std::runtime_error with the reason.
  std::optional<LedgerRecord> Record(std::string_view line);

 private:
  const EvaluationPlan* plan_;
  std::uint64_t identity_;
  std::map<UnitKey, std::uint64_t> units_;
};

/// Calls `use` for each complete line, numbered from 1. Returns the total size of these lines.
std::size_t ForEachLine(std::string_view text,
                        const std::function<void(std::string_view, int)>& use);

/// Describes an error in a unit's line and the remedy.
[[nodiscard]] std::string DamagedLine(int number, const std::exception& e);

/// @throws std::runtime_error naming the path and the reason.
[[noreturn]] void Fail(const std::filesystem::path& path, const std::string& reason);

}  // namespace dfr::experiment::internal
