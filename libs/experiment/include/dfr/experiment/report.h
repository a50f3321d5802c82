#pragma once

#include <cstddef>
#include <filesystem>
#include <iosfwd>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/experiment/summary.h"

namespace dfr::experiment {

/// Style of a method, with the same name, colour, dashes and marker on all pages and pictures.
struct NamedStyle {
  std::string_view method;  ///< Name of the method in plans and on command lines, or an outcome.
  std::string_view name;    ///< Name shown to readers.
  int style = 0;            ///< Index of the colour, dashes and marker.
};
/// Returns all methods and outcomes with a predefined style.
[[nodiscard]] std::span<const NamedStyle> NamedStyles();
/// Returns the style of a method or outcome by its id or its name; -1 if it has none.
[[nodiscard]] int MethodStyle(std::string_view method);

/// One line of a ReportPlot. Points with a non-finite y are skipped.
struct ReportSeries {
  std::string name;  ///< Name in the legend below the figure; empty: none.
  std::vector<double> x;
  std::vector<double> y;
  std::vector<double> low = {};   ///< Lower edge of a band, or of a point's bar; empty: none.
  std::vector<double> high = {};  ///< Upper edge of the band or bar, as long as `low`.
  /// Command that prints the episodes of each point, shown on hover or tap; empty: none.
  std::vector<std::string> commands = {};
  /// Colour, dashes and marker. -1: MethodStyle() of `name`, otherwise the first free style of the
  /// plot.
  int style = -1;
};

/// An additional line plot, for example of convergence or overlap.
struct ReportPlot {
  std::string title = {};
  std::string x_label = {};
  bool percent = false;  ///< y is a fraction: 0.25 is shown as 25 %.
  std::optional<double> x_min = {};
  std::optional<double> x_max = {};
  std::optional<double> y_min = {};
  std::optional<double> y_max = {};
  std::vector<ReportSeries> series = {};
};

struct ReportFigure {
  std::string heading;
  std::string caption;
  std::vector<ReportPlot> plots;  ///< Plots, side by side, up to three in a row.
};

/// A table of texts, for example of the paper's results and ours.
struct ReportTable {
  std::string heading;
  std::string caption;
  std::vector<std::string> header;
  std::vector<std::vector<std::string>> rows;  ///< Rows, each as long as `header`.
  /// Commands that print the episodes behind the entries, shown on hover or tap. Same shape as
  /// `rows`; empty: none.
  std::vector<std::vector<std::string>> commands = {};
};

/// Prints the heading and the table with aligned columns for a terminal. The first `left_aligned`
/// columns are left-aligned.
void PrintTable(const ReportTable& table, std::ostream& out, std::size_t left_aligned = 2);

struct ReportNote {
  std::string heading;
  std::string text;  ///< Paragraphs, with blank lines between them.
};

/// A picture (png, jpg, webp, gif) or video (webm, mp4) to embed. Browsers play VP8, VP9 and H.264.
struct ReportMedia {
  std::filesystem::path path;
  std::string caption;
  std::string content = {};  ///< Empty: read from `path`, whose extension gives the type.
};

/// An experiment's recommendation about the use of a method.
struct ReportJudgement {
  std::string method = {};
  int grade = 0;  ///< 0: fit for use, 1: doubtful, 2: do not use
  std::string why = {};
};

/// Content of a report in addition to the summary. All texts are escaped.
struct ReportOptions {
  std::string title = {};
  /// First sentence of the page: fit for use, doubtful or do not use, and the reason. Empty: the
  /// page lists `judgements`; without these, it derives judgements from the summary's contrasts.
  std::string verdict = {};
  std::vector<ReportJudgement> judgements = {};
  std::string judged_by = {};  ///< Rule behind `judgements`, shown below them.
  /// Methods that the derived judgements leave out, such as placebos and oracles.
  std::set<std::string> unjudged = {};
  /// Program that wrote the report. On hover or tap of a number, the page shows the command of this
  /// program that prints the ids of the episodes behind the number. Empty: not shown.
  std::string program = {};
  std::string introduction = {};  ///< Paragraphs, as in ReportNote::text.
  /// Display names of methods: {"dfr", "DFR"}. The paper's methods have built-in names.
  std::map<std::string, std::string> method_names = {};
  std::map<std::string, std::string> learner_names = {};
  std::vector<std::pair<std::string, std::string>> settings = {};
  std::vector<ReportMedia> media = {};
  std::vector<ReportFigure> figures = {};
  std::vector<ReportTable> tables = {};
  std::vector<ReportNote> notes = {};
};

/// Renders a self-contained page: a verdict on each method, the paper's three curves per learner
/// with bands, the outcomes of episodes, the figures of the options, and then all tables. Figures
/// are inline SVG; media are data URIs. The layout supports light and dark themes, narrow and wide
/// windows, and print. A summary without cells gives a page of the options' content only. The page
/// contains no measured times. It is therefore bit-identical for all machines with the same
/// instruction set.
/// @throws std::invalid_argument if a series, a table or a kind of media does not match its
///   description; std::runtime_error naming a media file that cannot be read.
[[nodiscard]] std::string RenderReport(const Summary& summary, const ReportOptions& options);

/// Writes RenderReport() to a temporary file and renames it when complete.
/// @throws as RenderReport(), and std::runtime_error naming the file.
void SaveReport(const Summary& summary, const ReportOptions& options,
                const std::filesystem::path& path);

}  // namespace dfr::experiment
