#include "apps/study/pictures/picture.h"

#include <algorithm>
#include <utility>

#include "apps/usage_error.h"
#include "dfr/core/features/features.h"
#include "dfr/experiment/report.h"

namespace dfr::study {

void SavePicture(const std::vector<experiment::FilmedEpisode>& recordings,
                 const sim::GalleryTask& task, const std::string& entries,
                 const std::filesystem::path& path) {
  const core::FeatureSelection all = core::FeatureSelection::All(task.plant->state_dim());
  const core::FeatureSelection chosen = apps::ValueOf("--entries", [&] {
    return entries.empty() ? all : core::FeatureSelection(task.plant->layout(), entries);
  });
  if (!entries.empty() && chosen.num_features() != 2) {
    throw apps::UsageError("--entries: a picture shows two entries of the state, not '" + entries +
                           "'");
  }
  const int across = chosen.indices()[0];
  const int up = chosen.indices()[1];
  std::vector<experiment::ReportPlot> plots;
  double low = 0.0;
  double high = 0.0;
  for (const experiment::FilmedEpisode& recording : recordings) {
    low = std::min(low, recording.states.col(up).minCoeff());
    high = std::max(high, recording.states.col(up).maxCoeff());
    if (plots.empty() || plots.back().title != recording.method) {
      plots.push_back({.title = recording.method});
    }
    std::vector<experiment::ReportSeries>& series = plots.back().series;
    const std::string outcome = core::Name(recording.result.outcome);
    // The legend names each outcome once.
    const bool named = std::ranges::count(series, outcome, &experiment::ReportSeries::name) > 0;
    experiment::ReportSeries line;
    line.name = named ? "" : outcome;
    line.style = experiment::MethodStyle(outcome);
    for (Eigen::Index i = 0; i < recording.states.rows(); ++i) {
      line.x.push_back(recording.states(i, across));
      line.y.push_back(recording.states(i, up));
    }
    series.push_back(std::move(line));
  }
  for (experiment::ReportPlot& plot : plots) {
    plot.y_min = low;
    plot.y_max = high;
  }
  experiment::SaveReport({},
                         {.title = task.name,
                          .introduction = task.summary + ".",
                          .figures = {{.heading = "Paths",
                                       .caption = "One line per episode.",
                                       .plots = std::move(plots)}}},
                         path);
}

}  // namespace dfr::study
