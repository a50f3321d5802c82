#include "dfr/experiment/film.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "dfr/core/contract.h"

namespace dfr::experiment {
namespace {

constexpr Eigen::Index kMostPoints = 1000;  // per line: recoveries can have thousands of controls

// Returns the indices of the states to draw: every stride-th state, and the last.
std::vector<Eigen::Index> Drawn(const FilmedEpisode& episode) {
  const Eigen::Index stride = episode.states.rows() / kMostPoints + 1;
  std::vector<Eigen::Index> rows;
  rows.reserve(static_cast<std::size_t>(episode.states.rows() / stride + 1));
  for (Eigen::Index t = 0; t + 1 < episode.states.rows(); t += stride) rows.push_back(t);
  if (episode.states.rows() > 0) rows.push_back(episode.states.rows() - 1);
  return rows;
}

// Splits a path where the source of controls changes: policy in style 0, recovery in style 1.
ReportPlot PathOf(const FilmedEpisode& episode, int across, int up) {
  ReportPlot plot{.title = episode.method};
  const std::vector<Eigen::Index> rows = Drawn(episode);
  const auto recovers = [&](Eigen::Index t) {
    return static_cast<std::size_t>(t) < episode.recovery.size() &&
           episode.recovery[static_cast<std::size_t>(t)];
  };
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const bool recovery = recovers(rows[k]);
    const bool last = k + 1 == rows.size();
    const double x = episode.states(rows[k], across);
    const double y = episode.states(rows[k], up);
    if (!std::isfinite(x) || !std::isfinite(y)) break;  // the plant has failed
    if (k > 0) {
      plot.series.back().x.push_back(x);
      plot.series.back().y.push_back(y);
    }
    // An episode without controls is drawn as a single point.
    const bool begins = k == 0 || (!last && recovery != recovers(rows[k - 1]));
    if (!begins) continue;
    const char* name = recovery ? "recovery" : "policy";
    // The legend shows each name once.
    const bool named = std::ranges::count(plot.series, name, &ReportSeries::name) > 0;
    plot.series.push_back(
        {.name = named ? "" : name, .x = {x}, .y = {y}, .style = recovery ? 1 : 0});
  }
  return plot;
}

// Returns the range of all values of the plots, with a margin.
std::pair<double, double> RangeOf(const std::vector<ReportPlot>& plots,
                                  std::vector<double> ReportSeries::*values) {
  double low = std::numeric_limits<double>::infinity();
  double high = -low;
  for (const ReportPlot& plot : plots) {
    for (const ReportSeries& series : plot.series) {
      for (const double value : series.*values) {
        if (!std::isfinite(value)) continue;
        low = std::min(low, value);
        high = std::max(high, value);
      }
    }
  }
  if (!(low <= high)) return {0.0, 1.0};
  // Rounding alone may vary a constant by this amount.
  const double rounding = 1e-9 * std::max(std::abs(low), std::abs(high));
  const double margin = high - low > rounding ? 0.03 * (high - low) : std::max(0.5, rounding);
  return {low - margin, high + margin};
}

std::vector<std::string> NamesOf(const core::StateLayout& layout) {
  std::vector<std::string> names;
  for (const core::StateLayout::Block& block : layout.blocks) {
    for (int k = 0; k < block.size; ++k) {
      names.push_back(block.size == 1 ? block.name : block.name + "[" + std::to_string(k) + "]");
    }
  }
  return names;
}

}  // namespace

std::string DescribeEnd(const EpisodeResult& result) {
  return std::string(core::Name(result.outcome)) +
         (result.cause.empty() ? "" : ": " + result.cause) + " after " +
         std::to_string(result.controls) + " controls, " +
         std::to_string(result.recovery_controls) + " of them recovery";
}

void CheckPage(const std::filesystem::path& path) {
  if (path.extension() == ".html") return;
  throw std::runtime_error(path.string() +
                           ": without pictures a film is a page: choose a name that ends in .html");
}

void SaveFilm(const std::string& title, const core::StateLayout& layout,
              std::span<const FilmedEpisode> episodes, const std::filesystem::path& path,
              const std::string& entries, const std::vector<ReportMedia>& media) {
  CheckPage(path);
  const int dim = layout.state_dim();
  const std::vector<std::string> names = NamesOf(layout);
  ReportOptions page{.title = title, .media = media};
  for (const FilmedEpisode& episode : episodes) {
    page.introduction += episode.method + ": " + DescribeEnd(episode.result) + ".\n\n";
  }
  if (dim > 1) {
    const core::FeatureSelection chosen = entries.empty() ? core::FeatureSelection::All(dim)
                                                          : core::FeatureSelection(layout, entries);
    DFR_THROW_UNLESS(entries.empty() || chosen.num_features() == 2,
                     "paths show two entries of the state, not '" << entries << "'");
    const auto across = static_cast<std::size_t>(chosen.indices()[0]);
    const auto up = static_cast<std::size_t>(chosen.indices()[1]);
    ReportFigure paths{
        .heading = "Paths",
        .caption = names[up] + " over " + names[across] + ". All begin in the same state.",
        .plots = {}};
    for (const FilmedEpisode& episode : episodes) {
      paths.plots.push_back(PathOf(episode, chosen.indices()[0], chosen.indices()[1]));
      paths.plots.back().x_label = names[across];
    }
    const auto x = RangeOf(paths.plots, &ReportSeries::x);
    const auto y = RangeOf(paths.plots, &ReportSeries::y);
    for (ReportPlot& plot : paths.plots) {
      plot.x_min = x.first;
      plot.x_max = x.second;
      plot.y_min = y.first;
      plot.y_max = y.second;
    }
    page.figures.push_back(std::move(paths));
  }
  ReportFigure over_time{
      .heading = "The state over the controls", .caption = "One line per method.", .plots = {}};
  for (int entry = 0; entry < dim; ++entry) {
    ReportPlot plot{.title = names[static_cast<std::size_t>(entry)], .x_label = "controls"};
    for (const FilmedEpisode& episode : episodes) {
      ReportSeries line{.name = episode.method, .x = {}, .y = {}};
      for (const Eigen::Index t : Drawn(episode)) {
        line.x.push_back(static_cast<double>(t));
        line.y.push_back(episode.states(t, entry));
      }
      plot.series.push_back(std::move(line));
    }
    over_time.plots.push_back(std::move(plot));
  }
  for (ReportPlot& plot : over_time.plots) {
    const auto y = RangeOf({plot}, &ReportSeries::y);
    plot.y_min = y.first;
    plot.y_max = y.second;
  }
  page.figures.push_back(std::move(over_time));
  SaveReport({}, page, path);
}

}  // namespace dfr::experiment
