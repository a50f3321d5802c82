#include "dfr/experiment/report.h"

#include <algorithm>
#include <cstdio>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

#include "commands.h"
#include "dfr/core/build_info.h"
#include "dfr/core/features/absolute_actions.h"
#include "dfr/core/numerics/quantile.h"
#include "dfr/core/text/format.h"
#include "dfr/experiment/intervals.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_advice.h"
#include "replay.h"

namespace dfr::apps::guard {
namespace {

using Episode = ReplayedEpisode;

// Plots median, interquartile range and minimum of l over time.
experiment::ReportPlot LevelPlot(const std::string& title, const std::vector<Episode>& episodes,
                                 double alarm_level) {
  experiment::ReportPlot plot{.title = title, .x_label = "step"};
  experiment::ReportSeries middle{.name = "median and quartiles", .x = {}, .y = {}};
  experiment::ReportSeries lowest{.name = "lowest", .x = {}, .y = {}, .style = 1};
  experiment::ReportSeries alarm{.name = "alarm", .x = {}, .y = {}, .style = 7};
  std::size_t longest = 0;
  for (const Episode& episode : episodes) longest = std::max(longest, episode.levels.size());
  // Far outside, l falls with the squared distance; the limit keeps the rest of the plot readable.
  const double floor = -4.0 * std::max(1.0, alarm_level);
  for (std::size_t t = 0; t < longest; ++t) {
    std::vector<double> here;
    for (const Episode& episode : episodes) {
      if (t < episode.levels.size()) here.push_back(std::max(floor, episode.levels[t]));
    }
    const double x = static_cast<double>(t);
    middle.x.push_back(x);
    middle.y.push_back(core::Median(here));
    middle.low.push_back(core::Quantile(here, 0.25));
    middle.high.push_back(core::Quantile(here, 0.75));
    lowest.x.push_back(x);
    lowest.y.push_back(*std::min_element(here.begin(), here.end()));
    alarm.x.push_back(x);
    alarm.y.push_back(-alarm_level);
  }
  plot.series = {std::move(middle), std::move(lowest), std::move(alarm)};
  return plot;
}

experiment::ReportTable EpisodeTable(const std::string& heading, const std::string& caption,
                                     std::vector<Episode> episodes) {
  std::sort(episodes.begin(), episodes.end(),
            [](const Episode& a, const Episode& b) { return a.lowest < b.lowest; });
  experiment::ReportTable table{.heading = heading,
                                .caption = caption,
                                .header = {"Episode", "Steps", "Passed, %", "Inside, %", "Lowest l",
                                           "First alarm", "Lead, steps"},
                                .rows = {}};
  for (const Episode& episode : episodes) {
    const int last = static_cast<int>(episode.levels.size()) - 1;
    const bool alarm = episode.first_alarm >= 0;
    table.rows.push_back(
        {episode.name, std::to_string(last),
         core::Format("%.1f", 100.0 * episode.shadow.passed / std::max(1, episode.shadow.actions)),
         core::Format("%.1f", 100.0 * episode.inside), core::Format("%.3f", episode.lowest),
         alarm ? std::to_string(episode.first_alarm) : "-",
         alarm ? std::to_string(last - episode.first_alarm) : "-"});
  }
  return table;
}

int Alarms(const std::vector<Episode>& episodes) {
  return static_cast<int>(std::count_if(episodes.begin(), episodes.end(),
                                        [](const Episode& e) { return e.first_alarm >= 0; }));
}

std::string Rate(int count, int of) {
  const auto interval = experiment::ProportionInterval(count, of);
  return core::Format("%d of %d, %.1f %% [%.1f, %.1f]", count, of, 100.0 * count / of,
                      100.0 * interval.low, 100.0 * interval.high);
}

double MeanInside(const std::vector<Episode>& episodes) {
  return std::accumulate(episodes.begin(), episodes.end(), 0.0,
                         [](double sum, const Episode& e) { return sum + e.inside; }) /
         static_cast<double>(episodes.size());
}

// Share of the actions that the guard's strategy passes unchanged.
double Passed(const std::vector<Episode>& episodes) {
  double actions = 0.0;
  double passed = 0.0;
  for (const Episode& episode : episodes) {
    actions += episode.shadow.actions;
    passed += episode.shadow.passed;
  }
  return passed / std::max(1.0, actions);
}

std::string Introduction(const safety::GuardModel& model, const ReportOptions& options,
                         const std::vector<Episode>& episodes) {
  const double alarm_level = model.settings().alarm_level;
  return core::Format(
             "l is the log form of g: positive inside what was demonstrated at a time step, and "
             "falling with the squared distance outside. Of the states in %s, %.1f %% are inside "
             "(mean over episodes). An alarm is raised at l < %.3g.",
             options.demonstrations.filename().c_str(), 100.0 * MeanInside(episodes),
             -alarm_level) +
         core::Format("\n\nStrategy %s passes %.1f %% of their actions unchanged.",
                      safety::Name(model.settings().strategy), 100.0 * Passed(episodes)) +
         "\n\nEpisodes with an alarm: " +
         Rate(Alarms(episodes), static_cast<int>(episodes.size())) +
         core::Format(
             " (95 %% interval). The fit promises an alarm in at most %.3g of further "
             "demonstrations, %s; demonstrations of the fit raise fewer.",
             model.summary().false_alarms, safety::DescribeGuarantee(model.summary()).c_str());
}

// First sentence of the page: the benefit of the guard, or the reason not to use it.
std::string Verdict(const safety::GuardModel& model, const std::vector<Episode>& episodes,
                    const std::vector<Episode>& failures) {
  const double passed = Passed(episodes);
  const double inside = MeanInside(episodes);
  const int alarms = Alarms(episodes);
  const auto count = static_cast<int>(episodes.size());
  const double promised = model.summary().false_alarms;
  const std::string share = core::Format(
      "the guard passes %.0f %% of these demonstrations' actions unchanged, and %.0f "
      "%% of their states are inside the support",
      100.0 * passed, 100.0 * inside);
  if (inside < 0.5) {
    return "Do not use this guard for such episodes: " + share +
           ". Fit it to demonstrations like these.";
  }
  if (experiment::ProportionInterval(alarms, count).low > promised) {
    return "Do not use this guard for such episodes: " + share +
           core::Format(
               ", but %d of %d raise an alarm, more than the promised share of %.3g. Fit "
               "it to demonstrations like these.",
               alarms, count, promised);
  }
  const auto failed = static_cast<int>(failures.size());
  if (failed > 0 && experiment::ProportionInterval(Alarms(failures), failed).low <= promised) {
    return "Doubtful: " + share +
           core::Format(
               ", but alarms in %d of %d episodes that went wrong do not distinguish these from "
               "good ones.",
               Alarms(failures), failed);
  }
  if (passed < 0.5) {
    return "Doubtful: " + share +
           ". It would replace most actions of a good policy; run it with --strategy monitor "
           "first.";
  }
  const std::vector<std::string> warnings = safety::Warnings(model);
  if (!warnings.empty()) return "Doubtful: " + share + ", but " + warnings.front();
  return "Fit for use: " + share + core::Format("; %d of %d raise an alarm.", alarms, count);
}

// Plots the lowest l of each episode.
experiment::ReportPlot LowestPlot(const std::string& title, const std::vector<Episode>& episodes,
                                  double alarm_level) {
  experiment::ReportPlot plot{.title = title, .x_label = "episodes, lowest first"};
  experiment::ReportSeries lowest{.name = "lowest", .x = {}, .y = {}, .style = 1};
  experiment::ReportSeries alarm{.name = "alarm", .x = {}, .y = {}, .style = 7};
  std::vector<double> levels;
  levels.reserve(episodes.size());
  const double floor = -4.0 * std::max(1.0, alarm_level);
  for (const Episode& episode : episodes) levels.push_back(std::max(floor, episode.lowest));
  std::sort(levels.begin(), levels.end());
  for (std::size_t i = 0; i < levels.size(); ++i) {
    lowest.x.push_back(static_cast<double>(i + 1));
    lowest.y.push_back(levels[i]);
    alarm.x.push_back(static_cast<double>(i + 1));
    alarm.y.push_back(-alarm_level);
  }
  plot.series = {std::move(lowest), std::move(alarm)};
  return plot;
}

// Plots each episode's share of actions that pass unchanged.
experiment::ReportPlot PassedPlot(const std::string& title, const std::vector<Episode>& episodes) {
  experiment::ReportPlot plot{.title = title,
                              .x_label = "episodes, least first",
                              .percent = true,
                              .y_min = 0.0,
                              .y_max = 1.0};
  experiment::ReportSeries passed{.name = "passed unchanged", .x = {}, .y = {}, .style = 3};
  std::vector<double> shares;
  shares.reserve(episodes.size());
  for (const Episode& episode : episodes) {
    shares.push_back(static_cast<double>(episode.shadow.passed) /
                     std::max(1, episode.shadow.actions));
  }
  std::sort(shares.begin(), shares.end());
  for (std::size_t i = 0; i < shares.size(); ++i) {
    passed.x.push_back(static_cast<double>(i + 1));
    passed.y.push_back(shares[i]);
  }
  plot.series = {std::move(passed)};
  return plot;
}

std::string FailureNote(const std::vector<Episode>& failures) {
  std::vector<double> leads;
  for (const Episode& episode : failures) {
    if (episode.first_alarm >= 0) {
      leads.push_back(static_cast<double>(episode.levels.size()) - 1.0 - episode.first_alarm);
    }
  }
  return "\n\nEpisodes that went wrong, with an alarm: " +
         Rate(static_cast<int>(leads.size()), static_cast<int>(failures.size())) +
         (leads.empty()
              ? std::string(".")
              : core::Format(
                    "; the alarm precedes the end by %.0f steps (median; quartiles %.0f and "
                    "%.0f).",
                    core::Median(leads), core::Quantile(leads, 0.25), core::Quantile(leads, 0.75)));
}

experiment::ReportTable FeatureTable(const safety::GuardModel& model, const Drivers& drivers) {
  experiment::ReportTable table{
      .heading = "Influence of the state entries on g",
      .caption =
          "Mean slope of l along each entry times the entry's spread over demonstrations, as a "
          "share of the sum. An entry with a share near zero can be left out; check that the "
          "largest shares belong to entries that matter.",
      .header = {"Entry", "Share, %"},
      .rows = {}};
  for (const auto& [share, entry] : drivers.Ranked()) {
    table.rows.push_back(
        {core::EntryName(model.task_layout(), entry), core::Format("%.1f", 100.0 * share)});
  }
  return table;
}

// Table of the assumptions of a certificate, for the person who approves it.
experiment::ReportTable CertificateTable(const safety::GuardModel& model,
                                         const std::vector<Episode>& episodes) {
  const safety::GuardSummary& summary = model.summary();
  const double level = std::max(0.0, model.settings().alarm_level);
  double actions = 0.0;
  double passing = 0.0;
  for (const Episode& episode : episodes) {
    actions += static_cast<double>(episode.levels.size()) - 1.0;
    passing += episode.passing;
  }
  const std::string coverage = core::Format(
      "with %.0f %% confidence %.1f %% of further demonstrations stay below%s",
      100.0 * summary.direction_error.confidence, 100.0 * summary.direction_error.coverage,
      summary.held_out > 0 ? "" : ", approximately");
  experiment::ReportTable table{
      .heading = "Assumptions of the certificate",
      .caption = core::Format(
          "Of the actions of these demonstrations, %.1f %% would pass unchanged. States are "
          "certified, one after each action, but not the paths between them, and only as far as "
          "the features show the state. docs/certificates.md has theorem and proof.",
          100.0 * passing / std::max(1.0, actions)),
      .header = {"Assumption", "Value", "Source"},
      .rows = {
          {"no state with l >= -eta meets a constraint", core::Format("eta = %.3g", level),
           "assumed; eta is the alarm level; holds if demonstrations kept the clearance below"},
          {"|dz - J u| <= eps |u|", core::Format("eps = %.3g", model.settings().direction_error),
           core::Format("measured at each action; %.3g in demonstrations, ",
                        summary.direction_error.value) +
               coverage},
          {"features are exact, and show the constraints", "-", "assumed"},
          {"the issued action was applied, and nothing else moves", "-",
           "assumed; one call for each state is checked"}}};
  return table;
}

// Table of two distances: the distance that demonstrations must have kept from obstacles, and the
// distance of these episodes' states from the demonstrated states that the guard keeps.
experiment::ReportTable ClearanceTable(const safety::GuardModel& model, const Strays& strays) {
  experiment::ReportTable table{
      .heading = "Clearance",
      .caption =
          "A state that raises no alarm is at most Required away from a demonstrated state, in all "
          "blocks at once, in each block's unit. Required is the largest value over time steps, "
          "and Median is their median. "
          "Such a state meets no obstacle if the demonstrations kept more than Required from all "
          "obstacles. The "
          "guard has no data on obstacles. Compare Required with the smallest distance in the "
          "recordings between an obstacle and the point that the block measures, less the size of "
          "the body around that point. If the obstacle's position is a block, too, compare with "
          "the "
          "sum of both rows. Strayed: the largest distance of these demonstrations' states "
          "from the demonstrated states that the guard keeps. Only states with an alarm exceed "
          "Required.",
      .header = {"Block", "Required", "Step", "Median", "Strayed", "Median strayed"},
      .rows = {}};
  auto distances = strays.Distances();
  for (const safety::Clearance& clearance : safety::Clearances(model)) {
    const auto found = distances.find(clearance.block);
    const bool known = found != distances.end();
    table.rows.push_back(
        {clearance.block, core::Format("%.3g", clearance.largest), std::to_string(clearance.step),
         core::Format("%.3g", clearance.median),
         known ? core::Format("%.3g", *std::ranges::max_element(found->second)) : "-",
         known ? core::Format("%.3g", core::Median(found->second)) : "-"});
  }
  return table;
}

std::vector<std::pair<std::string, std::string>> Settings(const safety::GuardModel& model) {
  const safety::GuardSettings& settings = model.settings();
  const safety::GuardSummary& summary = model.summary();
  const std::string& spec = model.task().features().selection().spec();
  return {{"fitted to", core::Format("%d demonstrations, %d actions, %s", summary.demonstrations,
                                     summary.transitions, summary.source.c_str())},
          {"features", spec.empty() ? "the whole state" : spec},
          {"nu, gamma", core::Format("%g, %g", summary.nu, summary.gamma)},
          {"time steps", std::to_string(model.num_steps())},
          {"strategy", safety::Name(settings.strategy)},
          {"horizon", std::to_string(settings.horizon)},
          {"action limit", safety::Join(settings.action_limit)}};
}

}  // namespace

void RunReport(const ReportOptions& options) {
  const auto model = LoadGuard(options.guard);
  const double alarm_level = model->settings().alarm_level;
  Drivers drivers(*model);
  Strays strays(*model);
  const std::vector<Episode> episodes =
      Replay(model, options.demonstrations, options.filter_key,
             [&](const core::Matrix& states, const std::vector<int>& steps) {
               drivers.Add(states, steps);
               strays.Add(states, steps);
             });
  std::vector<Episode> failures;
  if (!options.failures.empty()) failures = Replay(model, options.failures, "", nullptr);

  experiment::ReportOptions page;
  page.title = "Guard " + options.guard.filename().string();
  page.verdict = Verdict(*model, episodes, failures);
  page.introduction = Introduction(*model, options, episodes);
  experiment::ReportFigure levels{
      .heading = "Levels of the episodes",
      .caption =
          "l over time: median and interquartile range over the episodes, minimum, and alarm "
          "level. Values far outside are cut off.",
      .plots = {LevelPlot("Demonstrations", episodes, alarm_level)}};
  page.tables.push_back(FeatureTable(*model, drivers));
  if (CanCertify(*model)) page.tables.push_back(CertificateTable(*model, episodes));
  page.tables.push_back(ClearanceTable(*model, strays));
  if (!failures.empty()) {
    page.introduction += FailureNote(failures);
    levels.plots.push_back(LevelPlot("Failures", failures, alarm_level));
    page.tables.push_back(EpisodeTable("Episodes that went wrong",
                                       "Lowest first. Lead: steps from the first alarm to the end.",
                                       failures));
  }
  page.figures.push_back(std::move(levels));
  experiment::ReportFigure each{
      .heading = "Episode by episode",
      .caption =
          "One point per episode: the share of its actions that the guard passes "
          "unchanged, and its lowest l.",
      .plots = {PassedPlot("Demonstrations: passed", episodes),
                LowestPlot("Demonstrations: lowest l", episodes, alarm_level)}};
  if (!failures.empty()) {
    each.plots.push_back(LowestPlot("Failures: lowest l", failures, alarm_level));
  }
  page.figures.push_back(std::move(each));
  page.tables.push_back(EpisodeTable("Demonstrations", "Lowest first.", episodes));
  page.settings = Settings(*model);
  experiment::Summary nothing;
  nothing.commit = core::BuildCommit();
  experiment::SaveReport(nothing, page, options.out);
  Print("%s\n", options.out.c_str());
}

}  // namespace dfr::apps::guard
