#include "report/report_parts.h"

#include <algorithm>
#include <cstddef>
#include <map>
#include <string>

#include "dfr/core/contract.h"
#include "dfr/core/files/read_file.h"
#include "dfr/core/text/format.h"
#include "report/html.h"
#include "report/svg_plot.h"

namespace dfr::experiment {
namespace internal {

void AddMedia(const std::vector<ReportMedia>& all, std::ostream& out) {
  if (all.empty()) return;
  out << "<h2>Pictures and videos</h2>\n<div class=\"media\">\n";
  for (const ReportMedia& media : all) {
    static const std::map<std::string, std::string> kTypes = {
        {".png", "image/png"}, {".jpg", "image/jpeg"},  {".jpeg", "image/jpeg"},
        {".gif", "image/gif"}, {".webp", "image/webp"}, {".webm", "video/webm"},
        {".mp4", "video/mp4"}};
    const auto type = kTypes.find(media.path.extension().string());
    DFR_THROW_UNLESS(type != kTypes.end(),
                     media.path.string()
                         << ": a report embeds png, jpg, gif, webp, webm and mp4 files");
    const std::string uri =
        "data:" + type->second + ";base64," +
        Base64(media.content.empty() ? core::ReadFile(media.path) : media.content);
    if (type->second.starts_with("video")) {
      out << "<figure><video controls loop muted playsinline src=\"" << uri << "\"></video>";
    } else {
      out << "<figure><img alt=\"" << Escape(media.caption) << "\" src=\"" << uri << "\">";
    }
    out << "<figcaption>" << Escape(media.caption) << "</figcaption></figure>\n";
  }
  out << "</div>\n";
}

void AddFigure(const ReportFigure& figure, std::ostream& out) {
  out << "<h2>" << Escape(figure.heading) << "</h2>\n<figure>\n<div class=\"row"
      << (figure.plots.size() == 1 ? " one" : "") << "\">\n";
  for (const ReportPlot& plot : figure.plots) out << SvgPlot(plot);
  out << "</div>\n"
      << Legend(figure.plots) << "<figcaption>" << Escape(figure.caption)
      << "</figcaption>\n</figure>\n";
}

void AddTable(const ReportTable& table, std::ostream& out) {
  // A <caption> would be as narrow as the table.
  out << "<h2>" << Escape(table.heading) << "</h2>\n<p class=\"caption\">" << Escape(table.caption)
      << "</p>\n<div class=\"wide\"><table><thead><tr>";
  for (const std::string& head : table.header) out << "<th>" << Escape(head) << "</th>";
  out << "</tr></thead><tbody>\n";
  for (std::size_t r = 0; r < table.rows.size(); ++r) {
    const std::vector<std::string>& row = table.rows[r];
    DFR_THROW_UNLESS(row.size() == table.header.size() &&
                         (table.commands.empty() || table.commands.at(r).size() == row.size()),
                     "report table '" << table.heading << "' has rows of different lengths");
    out << "<tr>";
    for (std::size_t c = 0; c < row.size(); ++c) {
      const std::string command = table.commands.empty() ? "" : table.commands[r][c];
      out << "<td class=\"text\"";
      if (!command.empty()) out << " title=\"" << Escape(command) << "\"";
      out << ">" << Escape(row[c]) << "</td>";
    }
    out << "</tr>\n";
  }
  out << "</tbody></table></div>\n";
}

}  // namespace internal

void PrintTable(const ReportTable& table, std::ostream& out, std::size_t left_aligned) {
  std::vector<std::size_t> widths;
  for (std::size_t c = 0; c < table.header.size(); ++c) {
    widths.push_back(table.header[c].size());
    for (const auto& row : table.rows) widths[c] = std::max(widths[c], row[c].size());
  }
  out << table.heading << '\n';
  const auto line = [&](const std::vector<std::string>& cells) {
    for (std::size_t c = 0; c < cells.size(); ++c) {
      const int width = static_cast<int>(widths[c]);
      out << core::Format("  %*s", c < left_aligned ? -width : width, cells[c].c_str());
    }
    out << '\n';
  };
  line(table.header);
  for (const auto& row : table.rows) line(row);
}

}  // namespace dfr::experiment
