#pragma once

#include <ostream>
#include <vector>

#include "dfr/experiment/report.h"

/// Parts of a page that are independent of the experiment.
namespace dfr::experiment::internal {

/// Shows the hover text on a click or tap.
inline constexpr const char* kTips = R"(<script>
{
  const tip = document.getElementById("tip");
  addEventListener("click", event => {
    let text = "";
    for (let e = event.target; e instanceof Element && !text; e = e.parentElement) {
      text = e.getAttribute("title") || e.querySelector(":scope > title")?.textContent || "";
    }
    tip.textContent = text;
    tip.hidden = !text;
  });
}
</script>
)";

/// @throws std::invalid_argument for a file that browsers do not show.
void AddMedia(const std::vector<ReportMedia>& all, std::ostream& out);
void AddFigure(const ReportFigure& figure, std::ostream& out);
/// @throws std::invalid_argument for rows of different lengths.
void AddTable(const ReportTable& table, std::ostream& out);

}  // namespace dfr::experiment::internal
