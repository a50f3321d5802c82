#pragma once

#include <filesystem>
#include <string>

#include "dfr/safety/guard_advice.h"
#include "dfr/safety/guard_model.h"

namespace dfr::apps::guard {

// One struct and one function a command; main.cc fills the one and calls the other. All throw
// std::exception with a message for the user.

struct CheckOptions {
  std::filesystem::path demonstrations;
  std::string filter_key;
  double action_limit = 1.0;
  std::filesystem::path repair;  ///< Write the episodes that can be read to this file; empty: none.
};
/// Prints what is wrong with demonstrations. @returns whether nothing is that would spoil a fit.
bool RunCheck(const CheckOptions& options);

struct ConvertOptions {
  std::filesystem::path demonstrations;
  std::string filter_key;
  std::filesystem::path
      out;         ///< .hdf5: robomimic's format; otherwise the folder of a Minari dataset.
  std::string id;  ///< The dataset's id; empty: the names of the last two folders.
  bool differences = false;  ///< Make increments of actions that are positions.
};
void RunConvert(const ConvertOptions& options);

struct FitOptions {
  std::filesystem::path demonstrations;
  std::string filter_key;
  std::filesystem::path out = "task.guard";
  std::string strategy = "guard";
  bool all = false;          ///< Episodes that did not complete the task, too.
  bool as_recorded = false;  ///< Actions that look like positions are none.
  bool strict = false;       ///< Findings are a failure.
  safety::GuardOptions guard;
};
/// @returns false if `strict` and something speaks against the guard, which is saved all the same.
bool RunFit(const FitOptions& options);

/// Prints what a file holds, what its figures mean, and what speaks against using it.
void Describe(const safety::GuardModel& model);
/// Prints what safety::Warnings() found, a line each.
void Describe(const std::vector<std::string>& findings);

struct ReportOptions {
  std::filesystem::path guard;
  std::filesystem::path demonstrations;
  std::string filter_key;
  std::filesystem::path failures;  ///< Episodes that went wrong; empty: none.
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

}  // namespace dfr::apps::guard
