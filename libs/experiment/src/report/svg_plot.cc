#include "report/svg_plot.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <set>
#include <sstream>

#include "dfr/core/contract.h"
#include "report/html.h"

namespace dfr::experiment::internal {
namespace {

// Dimensions of a panel, in units of its viewBox.
constexpr double kWidth = 380.0;
constexpr double kHeight = 262.0;
constexpr double kLeft = 52.0;
constexpr double kRight = 16.0;
constexpr double kTop = 34.0;
constexpr double kBottom = 44.0;
// Number of colours in report.css. Lines with a colour of the second half are dashed.
constexpr int kNumColours = 24;
constexpr int kNumMarkers = 6;
constexpr int kOutcomeStyles = 100;  // style of "completed"; "halted" and "collided" follow

std::string Coordinate(double value) {
  std::ostringstream text;
  text.precision(2);
  text << std::fixed << value;
  return text.str();
}

// Returns the smallest step, 1, 2, 2.5 or 5 times a power of ten, that gives at most `most` steps.
double NiceStep(double range, int most) {
  const double raw = range / most;
  const double power = std::pow(10.0, std::floor(std::log10(raw)));
  for (const double factor : {1.0, 2.0, 2.5, 5.0}) {
    if (factor * power >= raw * (1.0 - 1e-9)) return factor * power;
  }
  return 10.0 * power;
}

struct Axis {
  double low = 0.0;
  double high = 1.0;
  std::vector<double> ticks;
};

int DigitsOf(double step) {
  for (int digits = 0; digits < 6; ++digits) {
    const double scaled = step * std::pow(10.0, digits);
    if (std::abs(scaled - std::round(scaled)) < 1e-6 * scaled) return digits;
  }
  return 6;
}

void AddTicks(Axis& axis, double step) {
  // The first multiple of the step may exceed every int.
  const double first = std::ceil(axis.low / step - 1e-9);
  const auto count = static_cast<int>(std::floor(axis.high / step + 1e-9) - first);
  for (int i = 0; i <= count; ++i) axis.ticks.push_back((first + i) * step);
}

// Creates an axis from the smaller of 0 and the smallest value to the largest value, unless the
// plot sets the ends. A few well-separated values become the ticks.
Axis MakeXAxis(const ReportPlot& plot) {
  std::vector<double> values;
  for (const ReportSeries& series : plot.series) {
    values.insert(values.end(), series.x.begin(), series.x.end());
  }
  std::sort(values.begin(), values.end());
  values.erase(std::unique(values.begin(), values.end()), values.end());
  if (values.empty()) values = {0.0, 1.0};
  Axis axis;
  axis.low = plot.x_min.value_or(std::min(0.0, values.front()));
  axis.high = plot.x_max.value_or(values.back());
  if (!(axis.high > axis.low)) axis.high = axis.low + 1.0;
  // The labels of adjacent ticks need at least an eleventh of the axis.
  bool roomy = values.size() <= 8 && !plot.x_min && !plot.x_max;
  for (std::size_t i = 1; i < values.size(); ++i) {
    roomy = roomy && values[i] - values[i - 1] >= (axis.high - axis.low) / 11.0;
  }
  if (roomy) {
    axis.ticks = values;
  } else {
    AddTicks(axis, NiceStep(axis.high - axis.low, 6));
  }
  return axis;
}

Axis MakeYAxis(const ReportPlot& plot) {
  double low = plot.y_min.value_or(0.0);
  double high = low;
  for (const ReportSeries& series : plot.series) {
    for (const auto* values : {&series.y, &series.low, &series.high}) {
      for (const double value : *values) {
        if (!std::isfinite(value)) continue;
        low = plot.y_min ? low : std::min(low, value);
        high = std::max(high, value);
      }
    }
  }
  high = plot.y_max.value_or(high);
  if (!(high > low)) high = low + 1.0;
  const double step = NiceStep(high - low, 5);
  Axis axis;
  axis.low = plot.y_min.value_or(std::floor(low / step + 1e-9) * step);
  axis.high = plot.y_max.value_or(std::ceil(high / step - 1e-9) * step);
  AddTicks(axis, step);
  return axis;
}

std::string TickText(double tick, double step, bool percent) {
  if (percent) return Number(100.0 * tick, DigitsOf(100.0 * step)) + "\u2009%";
  return Number(tick, DigitsOf(step));
}

void CheckPlot(const ReportPlot& plot) {
  for (const ReportSeries& series : plot.series) {
    const bool fits = series.x.size() == series.y.size() &&
                      series.low.size() == series.high.size() &&
                      (series.low.empty() || series.low.size() == series.x.size()) &&
                      (series.commands.empty() || series.commands.size() == series.x.size());
    DFR_THROW_UNLESS(
        fits, "report series '" << series.name << "': x, y, low, high and commands differ in size");
  }
}

int SeriesStyle(const ReportPlot& plot, std::size_t i) {
  const auto own = [](const ReportSeries& series) {
    return series.style >= 0 ? series.style : MethodStyle(series.name);
  };
  int style = own(plot.series[i]);
  if (style >= 0) return style;
  std::set<int> taken = {0};  // style of the reference
  for (const ReportSeries& series : plot.series) taken.insert(own(series));
  for (std::size_t j = 0; j <= i; ++j) {
    if (own(plot.series[j]) >= 0) continue;
    do ++style;
    while (taken.contains(style));
  }
  return style;
}

// Returns the marker of style `style` at (x, y).
std::string Marker(int style, double x, double y) {
  const auto at = [&](double dx, double dy) {
    return Coordinate(x + dx) + "," + Coordinate(y + dy) + " ";
  };
  switch ((style + 2 * style / kNumColours) % kNumMarkers) {
    case 1:
      return "<polygon class=\"mark\" points=\"" + at(-3, -3) + at(3, -3) + at(3, 3) + at(-3, 3) +
             "\"/>";
    case 2:
      return "<polygon class=\"mark\" points=\"" + at(0, -4.2) + at(4.2, 0) + at(0, 4.2) +
             at(-4.2, 0) + "\"/>";
    case 3:
      return "<polygon class=\"mark\" points=\"" + at(0, -4) + at(3.8, 3) + at(-3.8, 3) + "\"/>";
    case 4:
      return "<polygon class=\"mark\" points=\"" + at(0, 4) + at(3.8, -3) + at(-3.8, -3) + "\"/>";
    case 5:
      return "<polygon class=\"mark\" points=\"" + at(-2, -4.5) + at(2, -4.5) + at(2, 4.5) +
             at(-2, 4.5) + "\"/>";
    default:
      return "<circle class=\"mark\" cx=\"" + Coordinate(x) + "\" cy=\"" + Coordinate(y) +
             "\" r=\"3.3\"/>";
  }
}

// One plot with its axes, in units of its viewBox.
class Panel {
 public:
  explicit Panel(const ReportPlot& plot)
      : plot_(plot), x_axis_(MakeXAxis(plot)), y_axis_(MakeYAxis(plot)), x_step_(x_axis_.high) {
    for (const double tick : x_axis_.ticks) {
      if (std::abs(tick) > 0.0) x_step_ = std::min(x_step_, std::abs(tick));
    }
  }

  [[nodiscard]] std::string Draw() const {
    std::ostringstream svg;
    svg << "<svg viewBox=\"0 0 " << kWidth << " " << kHeight << "\" role=\"img\" aria-label=\""
        << Escape(plot_.title) << "\">\n"
        << "<text class=\"panel\" x=\"0\" y=\"14\">" << Escape(plot_.title) << "</text>\n";
    DrawAxes(svg);
    // Draws all bands first: no band may cover a line.
    for (std::size_t i = 0; i < plot_.series.size(); ++i) DrawBand(i, svg);
    for (std::size_t i = 0; i < plot_.series.size(); ++i) DrawLine(i, svg);
    svg << "</svg>\n";
    return svg.str();
  }

 private:
  static constexpr double kPlotRight = kWidth - kRight;
  static constexpr double kPlotBottom = kHeight - kBottom;

  [[nodiscard]] double MapX(double x) const {
    return kLeft + (x - x_axis_.low) / (x_axis_.high - x_axis_.low) * (kPlotRight - kLeft);
  }
  [[nodiscard]] double MapY(double y) const {
    const double share = (y - y_axis_.low) / (y_axis_.high - y_axis_.low);
    return kPlotBottom - std::clamp(share, 0.0, 1.0) * (kPlotBottom - kTop);
  }
  [[nodiscard]] std::string XText(double x) const { return Number(x, DigitsOf(x_step_)); }
  [[nodiscard]] std::string YText(double y) const {
    return plot_.percent ? Number(100.0 * y, 1) + " %" : Number(y, 4);
  }
  [[nodiscard]] int StyleOf(std::size_t i) const { return SeriesStyle(plot_, i); }

  void DrawAxes(std::ostream& svg) const {
    const double y_step = y_axis_.ticks.size() > 1 ? y_axis_.ticks[1] - y_axis_.ticks[0] : 1.0;
    for (const double tick : y_axis_.ticks) {
      const std::string y = Coordinate(MapY(tick));
      svg << "<line class=\"" << (tick == y_axis_.low ? "axis" : "grid") << "\" x1=\"" << kLeft
          << "\" x2=\"" << kPlotRight << "\" y1=\"" << y << "\" y2=\"" << y << "\"/>"
          << "<text class=\"tick\" text-anchor=\"end\" x=\"" << kLeft - 7 << "\" y=\"" << y
          << "\" dy=\"0.35em\">" << TickText(tick, y_step, plot_.percent) << "</text>\n";
    }
    for (const double tick : x_axis_.ticks) {
      const std::string x = Coordinate(MapX(tick));
      svg << "<line class=\"axis\" x1=\"" << x << "\" x2=\"" << x << "\" y1=\"" << kPlotBottom
          << "\" y2=\"" << kPlotBottom + 4 << "\"/><text class=\"tick\" text-anchor=\"middle\" x=\""
          << x << "\" y=\"" << kPlotBottom + 16 << "\">" << XText(tick) << "</text>\n";
    }
    svg << "<text class=\"label\" text-anchor=\"middle\" x=\"" << 0.5 * (kLeft + kPlotRight)
        << "\" y=\"" << kHeight - 8 << "\">" << Escape(plot_.x_label) << "</text>\n";
  }

  void DrawBand(std::size_t i, std::ostream& svg) const {
    const ReportSeries& series = plot_.series[i];
    if (series.low.empty()) return;
    if (series.low.size() == 1) return DrawBar(i, svg);
    // The polygon follows the upper ends and returns along the lower ends.
    svg << "<polygon class=\"band\" " << StyleAttribute(StyleOf(i)) << " points=\"";
    const std::size_t n = series.low.size();
    for (std::size_t j = 0; j < 2 * n; ++j) {
      const std::size_t k = j < n ? j : 2 * n - 1 - j;
      if (!std::isfinite(series.low[k]) || !std::isfinite(series.high[k])) continue;
      svg << Coordinate(MapX(series.x[k])) << ","
          << Coordinate(MapY(j < n ? series.high[k] : series.low[k])) << " ";
    }
    svg << "\"/>\n";
  }

  // Draws the interval of a single point, which has no band.
  void DrawBar(std::size_t i, std::ostream& svg) const {
    const ReportSeries& series = plot_.series[i];
    if (!std::isfinite(series.low[0]) || !std::isfinite(series.high[0])) return;
    const std::string x = Coordinate(MapX(series.x[0]));
    svg << "<g " << StyleAttribute(StyleOf(i)) << "><line class=\"bar\" x1=\"" << x << "\" x2=\""
        << x << "\" y1=\"" << Coordinate(MapY(series.low[0])) << "\" y2=\""
        << Coordinate(MapY(series.high[0])) << "\"/></g>\n";
  }

  void DrawLine(std::size_t i, std::ostream& svg) const {
    const ReportSeries& series = plot_.series[i];
    std::string path;
    std::ostringstream markers;
    for (std::size_t k = 0; k < series.x.size(); ++k) {
      if (!std::isfinite(series.y[k])) continue;
      const double x = MapX(series.x[k]);
      const double y = MapY(series.y[k]);
      path += path.empty() ? "M" : "L";
      path.append(Coordinate(x)).append(" ").append(Coordinate(y));
      // A long curve has no markers, so a single finite point is invisible.
      if (series.x.size() > 40) continue;
      markers << "<g>" << Marker(StyleOf(i), x, y) << "<title>" << Escape(series.name) << ", "
              << Escape(plot_.x_label) << " " << XText(series.x[k]) << ": " << YText(series.y[k]);
      if (!series.low.empty()) {
        markers << " [" << YText(series.low[k]) << ", " << YText(series.high[k]) << "]";
      }
      if (!series.commands.empty()) markers << "\n" << Escape(series.commands[k]);
      markers << "</title></g>";
    }
    svg << "<g " << StyleAttribute(StyleOf(i)) << "><path class=\"line\""
        << " d=\"" << path << "\"/>" << markers.str() << "</g>\n";
  }

  const ReportPlot& plot_;
  Axis x_axis_;
  Axis y_axis_;
  double x_step_;
};

}  // namespace

std::string StyleAttribute(int style) {
  constexpr std::array<const char*, 3> kOutcomes = {"done", "halt", "hit"};
  const int outcome = style - kOutcomeStyles;
  if (outcome >= 0 && outcome < 3) {
    return std::string("style=\"--c:var(--") + kOutcomes[static_cast<std::size_t>(outcome)] + ")\"";
  }
  const int colour = style % kNumColours;
  return "style=\"--c:var(--s" + std::to_string(colour) + ")" +
         (colour < kNumColours / 2 ? "\"" : ";--dash:6 3;--dot:transparent\"");
}

std::string SvgPlot(const ReportPlot& plot) {
  CheckPlot(plot);
  return Panel(plot).Draw();
}

std::string Legend(std::span<const ReportPlot> plots) {
  std::vector<std::string> names;
  std::string html;
  for (const ReportPlot& plot : plots) {
    for (std::size_t i = 0; i < plot.series.size(); ++i) {
      const std::string& name = plot.series[i].name;
      if (name.empty() || std::ranges::count(names, name) > 0) continue;
      names.push_back(name);
      const int style = SeriesStyle(plot, i);
      html += "<span class=\"name\"><svg class=\"sample\" viewBox=\"0 0 24 12\" " +
              StyleAttribute(style) + "><path class=\"stroke\" d=\"M0 6L24 6\"/>" +
              Marker(style, 12.0, 6.0) + "</svg>" + Escape(name) + "</span>";
    }
  }
  return html.empty() ? html : "<div class=\"key\">" + html + "</div>\n";
}

std::string Bars(const std::vector<Bar>& bars) {
  std::ostringstream html;
  html << "<div class=\"bars\">\n";
  for (const Bar& bar : bars) {
    html << "<span>" << Escape(bar.name) << "</span><div>";
    for (const BarPart& part : bar.parts) {
      if (part.share <= 0.0) continue;
      html << "<i class=\"" << part.css_class
           << "\" style=\"flex-grow:" << Coordinate(100.0 * part.share) << "\" title=\""
           << Escape(bar.name) << ", " << Escape(part.name) << ": " << Number(100.0 * part.share, 1)
           << " %";
      if (!part.command.empty()) html << '\n' << Escape(part.command);
      html << "\">";
      if (part.share >= 0.1) html << Number(100.0 * part.share, 0);
      html << "</i>";
    }
    html << "</div>\n";
  }
  html << "</div>\n";
  return html.str();
}

std::string SvgSwatch(const std::string& css_class) {
  return "<svg viewBox=\"0 0 12 12\"><rect class=\"" + css_class +
         "\" width=\"12\" height=\"12\" rx=\"2\"/></svg>";
}

}  // namespace dfr::experiment::internal

namespace dfr::experiment {

std::span<const NamedStyle> NamedStyles() {
  // The reference is grey. Adjacent styles differ in lightness, hue and marker.
  static constexpr std::array<NamedStyle, 25> kStyles = {
      {{"baseline", "Baseline", 0},
       {"alone", "Alone", 0},
       {"early-stopping", "Early stopping", 1},
       {"dfr", "DFR", 2},
       {"controller", "Controller", 3},
       {"finite-difference", "Oracle", 4},
       {"lwr", "LWR alone", 5},
       {"knn", "Nearest neighbours alone", 6},
       {"ensemble", "Ensemble that stops", 7},
       {"dart", "DART", 8},
       {"dagger", "DAgger (asks the supervisor)", 9},
       {"true-jacobian", "True Jacobian (oracle)", 13},
       {"placebo-corrections", "Placebo: random corrections", 11},
       {"placebo-halts", "Placebo: random halts", 12},
       {"dfr-fine", "DFR, fine steps", 14},
       {"guard", "Guard", 10},
       {"baseline@none", "No policy", 15},
       {"lwr-cv", "LWR, cross-validated", 16},
       {"lwr-online", "LWR, online", 17},
       {"monitor", "Monitor", 18},
       {"certified", "Certified", 20},
       {"certified-direction", "Certified direction", 21},
       {"completed", "completed", internal::kOutcomeStyles},
       {"halted", "halted", internal::kOutcomeStyles + 1},
       {"collided", "collided", internal::kOutcomeStyles + 2}}};
  return kStyles;
}

int MethodStyle(std::string_view method) {
  for (const NamedStyle& style : NamedStyles()) {
    if (method == style.method || method == style.name) return style.style;
  }
  return -1;
}

}  // namespace dfr::experiment
