#pragma once

#include <span>
#include <string>
#include <vector>

#include "dfr/experiment/report.h"

namespace dfr::experiment::internal {

/// Returns the plot as an inline <svg>, coloured by the page's style sheet (--s0 to --s23, --ink,
/// --grid). Legend() names its lines.
[[nodiscard]] std::string SvgPlot(const ReportPlot& plot);

/// Returns a legend: the name of each line of the plots, once, beside a sample of its line and
/// marker. "" if no line has a name.
[[nodiscard]] std::string Legend(std::span<const ReportPlot> plots);

/// Returns style="..." with the colour of style `style`, 0 for the first. The colours repeat after
/// 24. Lines of the styles 12 to 23 are dashed, and their dots are hollow.
[[nodiscard]] std::string StyleAttribute(int style);

/// Part of a 100 % bar, in order from left to right.
struct BarPart {
  std::string name;
  std::string css_class;
  double share = 0.0;
  std::string command = {};  ///< Command that prints the part's episodes; empty: none.
};
struct Bar {
  std::string name;
  std::vector<BarPart> parts;
};
[[nodiscard]] std::string Bars(const std::vector<Bar>& bars);

/// Returns a small square in the colour of parts of class `css_class`.
[[nodiscard]] std::string SvgSwatch(const std::string& css_class);

}  // namespace dfr::experiment::internal
