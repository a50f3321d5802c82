#pragma once

#include <string>
#include <vector>

#include "dfr/experiment/report.h"

namespace dfr::experiment::internal {

/// The plot as an inline <svg>, coloured by the page's style sheet (--s0 to --s5, --ink, --grid).
/// Lines carry their names at the right end, so that no legend has to be looked up.
[[nodiscard]] std::string SvgPlot(const ReportPlot& plot);

/// A marker of style `style` at (x, y), the one its lines have.
[[nodiscard]] std::string SvgMarker(int style, double x, double y);

/// One 100 % bar of `parts`, left to right.
struct BarPart {
  std::string name;
  std::string css_class;
  double share = 0.0;
};
struct Bar {
  std::string name;
  std::vector<BarPart> parts;
};
[[nodiscard]] std::string SvgBars(const std::vector<Bar>& bars);

}  // namespace dfr::experiment::internal
