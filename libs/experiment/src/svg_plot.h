#pragma once

#include <string>
#include <vector>

#include "dfr/experiment/report.h"

namespace dfr::experiment::internal {

/// The plot as an inline <svg>, coloured by the page's style sheet (--s0 to --s5, --ink, --grid).
/// Lines carry their names at the right end, so that no legend has to be looked up.
[[nodiscard]] std::string SvgPlot(const ReportPlot& plot);

/// style="..." for what is drawn in the colour of style `style`, 0 for the first. They repeat.
[[nodiscard]] std::string StyleAttribute(int style);

/// One 100 % bar of `parts`, left to right.
struct BarPart {
  std::string name;
  std::string css_class;
  double share = 0.0;
  std::string command = {};  ///< That prints its episodes; empty: none.
};
struct Bar {
  std::string name;
  std::vector<BarPart> parts;
};
[[nodiscard]] std::string SvgBars(const std::vector<Bar>& bars);

/// A small square in the colour of parts of class `css_class`.
[[nodiscard]] std::string SvgSwatch(const std::string& css_class);

}  // namespace dfr::experiment::internal
