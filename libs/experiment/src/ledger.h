#pragma once

#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include "dfr/experiment/paired_evaluation.h"

namespace dfr::experiment::internal {

/// The file of finished units: JSON Lines, a header with plan and settings first.
class Ledger {
 public:
  /// Opens or begins the file. A last line without its end, which a killed run leaves, is cut off.
  /// @throws std::runtime_error as Evaluate() says.
  Ledger(const std::filesystem::path& path, const EvaluationPlan& plan,
         const std::map<std::string, std::string>& settings);

  /// What was there when it was opened.
  [[nodiscard]] const std::vector<UnitResult>& finished() const noexcept { return finished_; }

  /// Appends a line and hands it to the system at once.
  void Append(const UnitResult& result);

 private:
  std::filesystem::path path_;
  std::vector<UnitResult> finished_;
  std::ofstream file_;
};

}  // namespace dfr::experiment::internal
