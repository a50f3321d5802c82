#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "apps/study/study.h"
#include "dfr/experiment/report.h"

namespace dfr::study {

/// Separator of task and condition in a learner's name.
inline constexpr const char* kBetween = ": ";
/// A method's name in ids: "controller@lwr/density".
[[nodiscard]] std::string MethodOf(const std::string& controller, const std::string& policy);

/// Returns one table per policy, with a row for each task and condition. Each controller has
/// columns for completed / collided, for saved / harmed, and for passed with the size of changes.
/// Shares are in per cent. The first table has means and worst rows.
[[nodiscard]] std::vector<experiment::ReportTable> MakeTables(const std::vector<Row>& rows);

/// Judges each method over all policies except "none", compared with the same policies alone: first
/// by the 95 % intervals of the episodes that it saves and harms, then by the share of controls
/// that it passes. Placebos, other policies and monitors are not judged.
[[nodiscard]] std::vector<experiment::ReportJudgement> JudgeMethods(const std::vector<Row>& rows);
/// The rule of JudgeMethods(), as text for readers.
inline constexpr const char* kJudgedBy =
    "Judged over all tasks, conditions and learned policies, against these policies alone. Fit "
    "for use: 95 % intervals show that the method saves more episodes than it harms, and harms "
    "less than a tenth of those that the policies complete; it passes at least half of the "
    "controls unchanged.";

/// Returns the table of means and a table with a row for each of `rows`. Shares are in per cent
/// with the 95 % intervals of Totals. Adds a table of causes if `causes` is set.
[[nodiscard]] std::vector<experiment::ReportTable> MakeRowTables(const std::vector<Row>& rows,
                                                                 bool causes);

/// Effects of support and controller, one table per policy, from rows whose controllers are
/// "<controller>/<support>": means over all tasks and conditions of completed / collided /
/// passed in per cent / size of changes.
[[nodiscard]] std::vector<experiment::ReportTable> MakeGrid(const std::vector<Row>& rows);

/// Completion against intervention: one plot per policy, one point with its interval per method
/// that guards it.
[[nodiscard]] experiment::ReportFigure MakeFigure(const std::vector<Row>& rows);

/// Returns the rows of a good policy (one that completes at least half of the episodes) in which
/// `controller` collides in more than .5 % or harms more than 2 %.
[[nodiscard]] experiment::ReportTable WhereItFails(const std::vector<Row>& rows,
                                                   const std::string& controller);

/// Writes the rows as counts. @throws std::runtime_error naming a file that cannot be written.
void SaveCsv(const std::vector<Row>& rows, const std::filesystem::path& path);

}  // namespace dfr::study
