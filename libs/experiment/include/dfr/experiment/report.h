#pragma once

#include <cstddef>
#include <filesystem>
#include <iosfwd>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "dfr/experiment/summary.h"

namespace dfr::experiment {

/// One line of a ReportPlot. Points with a non-finite y are left out.
struct ReportSeries {
  std::string name;  ///< At the line's right end; empty: the line has none.
  std::vector<double> x;
  std::vector<double> y;
  std::vector<double> low = {};   ///< Lower edge of a band, or of a point's bar; empty: none.
  std::vector<double> high = {};  ///< Its upper edge, as long as `low`.
  /// Which command prints the episodes behind each point, shown where the mouse is on it; or empty.
  std::vector<std::string> commands = {};
  /// Colour and marker: methods have theirs by their place in the plan. -1: by place in the plot.
  int style = -1;
};

/// A further line plot, of a convergence or an overlap say.
struct ReportPlot {
  std::string title = {};
  std::string x_label = {};
  bool percent = false;  ///< y is a share: 0.25 reads 25 %.
  std::optional<double> x_min = {};
  std::optional<double> x_max = {};
  std::optional<double> y_min = {};
  std::optional<double> y_max = {};
  std::vector<ReportSeries> series = {};
};

struct ReportFigure {
  std::string heading;
  std::string caption;
  std::vector<ReportPlot> plots;  ///< Side by side, up to three in a row.
};

/// A table of texts: the paper's figures beside ours, for one.
struct ReportTable {
  std::string heading;
  std::string caption;
  std::vector<std::string> header;
  std::vector<std::vector<std::string>> rows;  ///< Each as long as `header`.
  /// Which command prints the episodes behind an entry, shown where the mouse is on it: as `rows`,
  /// or empty.
  std::vector<std::vector<std::string>> commands = {};
};

/// Prints the heading, then the table with its columns in line, for a terminal: the first
/// `left_aligned` columns at the left.
void PrintTable(const ReportTable& table, std::ostream& out, std::size_t left_aligned = 2);

struct ReportNote {
  std::string heading;
  std::string text;  ///< Paragraphs, with blank lines between them.
};

/// A picture (png, jpg, webp, gif) or video (webm, mp4) to embed. Browsers play VP8, VP9 and H.264.
struct ReportMedia {
  std::filesystem::path path;
  std::string caption;
};

/// What a report holds besides the summary. All texts are escaped.
struct ReportOptions {
  std::string title = {};
  /// The program that made it, whose command `episodes` prints the ids of the episodes behind a
  /// number: numbers say how, where the mouse is on them. Empty: they do not.
  std::string program = {};
  std::string introduction = {};  ///< Paragraphs, as ReportNote::text.
  /// How methods are called: {"dfr", "DFR"}. The paper's methods have names already.
  std::map<std::string, std::string> method_names = {};
  std::map<std::string, std::string> learner_names = {};
  std::vector<std::pair<std::string, std::string>> settings = {};
  std::vector<ReportMedia> media = {};
  std::vector<ReportFigure> figures = {};
  std::vector<ReportTable> tables = {};
  std::vector<ReportNote> notes = {};
};

/// A page that needs nothing but itself: the ratios between methods, the paper's three curves per
/// learner with bands, how episodes ended, the tables, and what the options add. Figures are inline
/// SVG, media are data URIs; light and dark, narrow and wide, and print are all looked after. A
/// summary without cells gives a page of what the options hold alone. Measured times are not in it,
/// so that it has the same bytes whoever ran which units.
/// @throws std::invalid_argument if a series, a table or a kind of media does not fit its
///   description; std::runtime_error naming a media file that cannot be read.
[[nodiscard]] std::string RenderReport(const Summary& summary, const ReportOptions& options);

/// Writes RenderReport() through a temporary file that is renamed when complete.
/// @throws as RenderReport(), and std::runtime_error naming the file.
void SaveReport(const Summary& summary, const ReportOptions& options,
                const std::filesystem::path& path);

}  // namespace dfr::experiment
