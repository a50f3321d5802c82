#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "dfr/safety/guard_advice.h"
#include "dfr/safety/guard_model.h"

namespace dfr::apps::guard {

// One struct and one function per command. main.cc fills the struct and calls the function. All
// functions throw std::exception with a message for the user.

/// Prints like printf(), and replaces control characters, which text from a data set or guard may
/// contain.
[[gnu::format(printf, 1, 2)]] void Print(const char* format, ...);

struct CheckOptions {
  std::filesystem::path demonstrations;
  std::string filter_key;
  double action_limit = 1.0;
  std::filesystem::path repair;  ///< File for the readable episodes; empty: none.
};
/// Prints errors and warnings about demonstrations. @returns true if there are no errors.
bool RunCheck(const CheckOptions& options);

struct ConvertOptions {
  std::filesystem::path demonstrations;
  std::string filter_key;
  std::filesystem::path
      out;         ///< .hdf5: robomimic's format; otherwise the folder of a Minari dataset.
  std::string id;  ///< The dataset's id; empty: the names of the last two folders.
  bool differences = false;  ///< Convert actions that are positions to increments.
};
void RunConvert(const ConvertOptions& options);

struct FitOptions {
  std::filesystem::path demonstrations;
  std::string filter_key;
  std::filesystem::path out = "task.guard";
  std::string strategy = "guard";
  bool all = false;          ///< Include episodes that did not complete the task.
  bool as_recorded = false;  ///< Use actions as recorded, even if they look like positions.
  bool strict = false;       ///< Treat warnings as a failure.
  safety::GuardOptions guard;
};
/// @returns false if `strict` and there is a warning. The guard is saved in any case.
bool RunFit(const FitOptions& options);

/// Returns the guard of a file. @throws std::runtime_error naming a missing or unreadable file.
[[nodiscard]] std::shared_ptr<const safety::GuardModel> LoadGuard(
    const std::filesystem::path& file);

/// Prints the content of a guard, the meaning of its figures, and warnings.
void Describe(const safety::GuardModel& model);
/// Prints each of safety::Warnings() in one line.
void Describe(const std::vector<std::string>& warnings);

struct ReportOptions {
  std::filesystem::path guard;
  std::filesystem::path demonstrations;
  std::string filter_key;
  std::filesystem::path failures;  ///< File of failed episodes; empty: none.
  std::filesystem::path out = "report.html";
};
void RunReport(const ReportOptions& options);

struct EvaluateOptions {
  std::filesystem::path guard;
  std::filesystem::path demonstrations;
  std::string filter_key;
};
void RunEvaluate(const EvaluateOptions& options);

struct ExportOptions {
  std::filesystem::path guard;
  std::filesystem::path onnx;
  std::filesystem::path libsvm;
};
void RunExport(const ExportOptions& options);
/// Returns the reason why the folder cannot receive an export; "" if it can.
[[nodiscard]] std::string UnusableExportFolder(const std::filesystem::path& folder);

}  // namespace dfr::apps::guard
