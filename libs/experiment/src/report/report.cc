#include "dfr/experiment/report.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <optional>
#include <ostream>
#include <set>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "dfr/core/files/atomic_file.h"
#include "dfr/experiment/episodes.h"
#include "report.css.h"
#include "report/html.h"
#include "report/page_words.h"
#include "report/report_parts.h"
#include "report/svg_plot.h"

namespace dfr::experiment {
namespace {

using internal::Escape;
using internal::Number;

class Page : internal::PageWords {
 public:
  using PageWords::PageWords;

  std::string Render() {
    const std::string title = options_.title.empty() ? summary_.experiment : options_.title;
    out_ << "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
         << "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>"
         << Escape(title) << "</title>\n<style>\n"
         << embedded::kReportCss << "</style>\n</head>\n<body>\n"
         << "<main>\n<h1>" << Escape(title) << "</h1>\n";
    Verdict();
    // Without methods to compare, the page shows only the options' content.
    const bool compared = !summary_.cells.empty();
    if (compared) {
      out_ << "<p class=\"meta\">experiment <code>" << Escape(summary_.experiment)
           << "</code>, preset <code>" << Escape(summary_.preset) << "</code>, seed <code>"
           << summary_.seed << "</code>, commit <code>" << Escape(summary_.commit)
           << "</code></p>\n";
    }
    out_ << internal::Paragraphs(options_.introduction);
    // A single data point has no curves; bars show everything.
    const bool one_point = DataPoints() < 2;
    if (compared) one_point ? Endings() : Curves();
    if (!one_point) Endings();
    internal::AddMedia(options_.media, out_);
    for (const ReportFigure& figure : options_.figures) internal::AddFigure(figure, out_);
    HowToFindEpisodes();
    Contrasts();
    if (compared) Averages();
    CollisionCauses();
    for (const ReportTable& table : options_.tables) internal::AddTable(table, out_);
    for (const ReportNote& note : options_.notes) {
      out_ << "<h2>" << Escape(note.heading) << "</h2>\n" << internal::Paragraphs(note.text);
    }
    Settings();
    if (compared) Cells();
    out_ << "</main>\n<output id=\"tip\" hidden></output>\n"
         << internal::kTips << "</body>\n</html>\n";
    return out_.str();
  }

 private:
  // Each method is judged by its worst learner. A method without a share of passed controls guards
  // no policy and is not judged.
  [[nodiscard]] std::vector<ReportJudgement> Judgements() const {
    std::vector<ReportJudgement> all;
    for (const std::string& method : methods_) {
      if (options_.unjudged.contains(method)) continue;
      ReportJudgement worst{.grade = -1};
      for (const Contrast& contrast : summary_.contrasts) {
        if (contrast.method != method) continue;
        ReportJudgement judged = Judge(contrast);
        if (judged.grade > worst.grade) worst = std::move(judged);
      }
      if (worst.grade < 0) continue;
      std::optional<double> passed;
      for (const Cell& cell : summary_.averages) {
        if (cell.method == method && cell.passed) {
          passed = std::min(passed.value_or(1.0), *cell.passed);
        }
      }
      if (!passed) continue;
      worst.why += "; passes " + Percent(*passed, 0) + " of the controls";
      all.push_back(std::move(worst));
    }
    return all;
  }

  void Verdict() {
    if (!options_.verdict.empty()) {
      out_ << "<p class=\"verdict\">" << Escape(options_.verdict) << "</p>\n";
      return;
    }
    const bool given = !options_.judgements.empty();
    const std::vector<ReportJudgement> judgements = given ? options_.judgements : Judgements();
    if (judgements.empty()) return;
    std::array<std::string, 3> lists;
    for (const ReportJudgement& judged : judgements) {
      lists.at(static_cast<std::size_t>(judged.grade)) +=
          "<li><span class=\"dot\" " + ColourOf(judged.method) + "></span>" +
          Escape(NameOf(judged.method)) + " (" + Escape(judged.why) + ")</li>";
    }
    constexpr std::array<const char*, 3> kGrades = {"Fit for use", "Doubtful", "Do not use"};
    out_ << "<div class=\"verdict\">";
    for (std::size_t grade = 0; grade < 3; ++grade) {
      if (lists[grade].empty()) continue;
      out_ << "<b>" << kGrades[grade] << "</b><ul>" << lists[grade] << "</ul>";
    }
    out_ << "<p class=\"caption\">";
    if (given) {
      out_ << Escape(options_.judged_by);
    } else {
      out_
          << "Judged in this experiment against "
          << Escape(NameOf(summary_.contrasts.front().against))
          << ", each method by its worst learner. Other policies, placebos and oracles are not "
             "judged. Fit for use: 95 % intervals show fewer collisions and at least 0.9 times the "
             "completions.";
    }
    out_ << "</p></div>\n";
  }

  void HowToFindEpisodes() {
    bool has_commands = !summary_.cells.empty();
    for (const ReportTable& table : options_.tables) {
      has_commands = has_commands || !table.commands.empty();
    }
    if (options_.program.empty() || !has_commands) return;
    const std::string program = Escape(options_.program);
    out_ << "<p class=\"caption\">Hover over a number, or tap it, to see the command that prints "
            "it with the "
            "ids of its episodes, worst first. FOLDER is the folder of this page. "
            "<code>"
         << program << " rerun FOLDER ID --methods METHOD --film FILE</code> shows an episode "
         << "beside another method.</p>\n";
  }

  void Contrasts() {
    if (summary_.contrasts.empty()) return;
    const std::string reference = Escape(NameOf(summary_.contrasts.front().against));
    for (const std::string& learner : learners_) {
      out_ << "<details" << (summary_.contrasts.size() <= 6 ? " open" : "") << "><summary>Against "
           << reference << ", learner " << Escape(LearnerNameOf(learner))
           << "</summary>\n<div class=\"cards\">\n";
      for (const Contrast& contrast : summary_.contrasts) {
        if (contrast.learner != learner) continue;
        const PairedContrast& ratios = contrast.ratios;
        out_ << "<div class=\"card\" " << ColourOf(contrast.method) << "><h4>"
             << Escape(NameOf(contrast.method)) << "</h4><div><span"
             << Title(FiltersOf(contrast, {"collided"})) << "><b>"
             << Change(ratios.collision_reduction) << "</b>collisions<br>";
        if (const auto& interval = ratios.collision_reduction_interval) {
          out_ << Range(-interval->high, -interval->low, 0);
        }
        out_ << "</span><span" << Title(FiltersOf(contrast, {"completed"})) << "><b>"
             << (ratios.completion_ratio ? Percent(*ratios.completion_ratio, 0) : "\u2013")
             << "</b>of its completions<br>";
        if (const auto& interval = ratios.completion_ratio_interval) {
          out_ << Range(interval->low, interval->high, 0);
        }
        out_ << "</span><span" << Title(FiltersOf(contrast)) << "><b>"
             << Times(contrast.controls_ratio)
             << "</b>controls per trajectory</span></div></div>\n";
      }
      out_ << "</div></details>\n";
    }
    const std::string& clusters = summary_.contrasts.front().clusters;
    out_
        << "<p class=\"caption\">Totals over all data points against " << reference
        << "'s, from the same start states. In brackets: Fieller's 95 % intervals, clustered by "
        << (clusters == "episodes"
                ? "start state within each trial. There are too few trials to cluster by these, so "
                  "the intervals do not include the variation between trials"
            : clusters == "trials" ? "trial"
                                   : "supervisor")
        << ". With fewer than 5 events of the method, or the same ratio in all clusters, they also "
           "cover the exact interval of the ratio of two rates.</p>\n";
  }

  [[nodiscard]] std::size_t DataPoints() const {
    std::set<int> points;
    for (const Cell& cell : summary_.cells) points.insert(cell.demonstrations);
    return points.size();
  }

  void Curves() {
    out_ << "<h2>Completed, halted, collided</h2>\n";
    struct Panel {
      const char* title;
      Share Cell::*share;
      core::Outcome outcome;
    };
    using core::Outcome;
    constexpr std::array<Panel, 3> kPanels = {
        Panel{"Completed", &Cell::completed, Outcome::kCompleted},
        Panel{"Halted", &Cell::halted, Outcome::kHalted},
        Panel{"Collided", &Cell::collided, Outcome::kCollided}};
    int episodes = 0;
    for (const std::string& learner : learners_) {
      std::vector<ReportPlot> plots;
      out_ << "<figure>\n<h3>Learner " << Escape(LearnerNameOf(learner))
           << "</h3>\n<div class=\"row\">\n";
      for (const Panel& panel : kPanels) {
        ReportPlot plot{.title = panel.title, .x_label = "demonstrations", .percent = true};
        plot.y_min = 0.0;
        // The same axis for all learners makes their rows comparable.
        double highest = 0.0;
        for (const Cell& cell : summary_.cells) {
          highest = std::max(highest, (cell.*panel.share).interval.high);
          episodes = cell.episodes;
        }
        const double step = highest > 0.5 ? 0.2 : 0.1;
        plot.y_max = std::min(1.0, step * std::max(1.0, std::ceil(highest / step - 1e-9)));
        for (const std::string& method : methods_) {
          ReportSeries series{.name = NameOf(method), .x = {}, .y = {}, .style = StyleOf(method)};
          for (const Cell& cell : summary_.cells) {
            if (cell.method != method || cell.learner != learner) continue;
            const Share& share = cell.*panel.share;
            series.x.push_back(cell.demonstrations);
            series.y.push_back(share.value);
            series.low.push_back(share.interval.low);
            series.high.push_back(share.interval.high);
            series.commands.push_back(Commands({FilterOf(cell, {core::Name(panel.outcome)})}));
          }
          plot.series.push_back(std::move(series));
        }
        out_ << internal::SvgPlot(plot);
        plots.push_back(std::move(plot));
      }
      out_ << "</div>\n" << internal::Legend(plots) << "</figure>\n";
    }
    out_ << "<p class=\"caption\">Share of " << episodes
         << " episodes per point; bands are 95 % intervals of Korn and Graubard, clustered by "
            "trial, or by supervisor if there are 5 or more. With fewer than 5 trials: Wilson's or "
            "Clopper and Pearson's, which treat episodes as independent.</p>\n";
  }

  void ShareCells(const Cell& cell) {
    for (const auto& [share, outcome] : {std::pair(&cell.completed, "completed"),
                                         {&cell.halted, "halted"},
                                         {&cell.collided, "collided"}}) {
      out_ << "<td class=\"n\"" << Title({FilterOf(cell, {outcome})}) << ">"
           << Number(100.0 * share->value, 1) << " <small>"
           << Range(share->interval.low, share->interval.high, 1) << "</small></td>";
    }
  }

  void InterventionCells(const Cell& cell) {
    out_ << "<td class=\"n\">" << (cell.passed ? Number(100.0 * *cell.passed, 1) : "\u2013")
         << "</td><td class=\"n\">" << (cell.change ? Number(*cell.change, 2) : "\u2013")
         << "</td>";
  }

  void Averages() {
    out_ << "<h2>All data points together</h2>\n<div class=\"wide\"><table><thead><tr>"
            "<th>Learner</th><th>Method</th><th class=\"n\">Completed, %</th>"
            "<th class=\"n\">Halted, %</th><th class=\"n\">Collided, %</th>"
            "<th class=\"n\">Passed, %</th><th class=\"n\">Mean<br>change</th>"
            "<th class=\"n\">Controls per<br>trajectory</th><th class=\"n\">Ratio</th>"
            "<th class=\"n\">of these<br>recovery</th><th class=\"n\">Collided alone,<br>reference "
            "alone</th></tr></thead><tbody>\n";
    std::string learner;
    for (const Cell& cell : summary_.averages) {
      StartRow(cell, learner);
      ShareCells(cell);
      InterventionCells(cell);
      const Contrast* contrast = nullptr;
      for (const Contrast& candidate : summary_.contrasts) {
        if (candidate.method == cell.method && candidate.learner == learner) contrast = &candidate;
      }
      const std::string controls = "<td class=\"n\"" + Title({FilterOf(cell)}) + ">";
      out_ << controls << Number(cell.controls_per_trajectory, 1) << "</td>";
      if (contrast == nullptr) {
        out_ << "<td></td>" << controls << Number(cell.recovery_controls, 1)
             << "</td><td></td></tr>\n";
        continue;
      }
      out_ << "<td class=\"n\"" << Title(FiltersOf(*contrast)) << ">"
           << Times(contrast->controls_ratio) << "</td>" << controls
           << Number(cell.recovery_controls, 1) << "</td><td class=\"n\"><span"
           << Title({OnlyCollided(*contrast, false)}) << ">" << contrast->only_method_collided
           << "</span>, <span" << Title({OnlyCollided(*contrast, true)}) << ">"
           << contrast->only_reference_collided << "</span></td></tr>\n";
    }
    const Cell& any = summary_.averages.front();
    out_ << "</tbody></table></div>\n<p class=\"caption\">"
         << Percent(static_cast<double>(any.redrawn_starts) / (any.redrawn_starts + any.episodes),
                    1)
         << " of the start states drawn were outside the first support, and were drawn again. "
            "Passed: controls that equal the policy's bit for bit; \u2013 for a method that is "
            "another policy. Mean change: the distance of the "
            "others from the policy's, in units of an ordinary demonstrated control, where it is "
            "measured. Alone: start states from which just one of the two collided. Measured "
            "times, which "
            "differ from run to run, are in times.json.</p>\n";
  }

  void Endings() {
    std::set<std::string> causes;
    for (const Cell& cell : summary_.averages) {
      for (const auto& [cause, count] : cell.halt_causes) causes.insert(cause);
    }
    constexpr std::array<const char*, 6> kClasses = {"h0", "h1", "h2", "h3", "h4", "h5"};
    const auto class_of = [&](const std::string& cause) {
      const auto place = std::distance(causes.begin(), causes.find(cause));
      return std::string(kClasses[static_cast<std::size_t>(place) % kClasses.size()]);
    };
    out_ << "<h2>How episodes ended</h2>\n<figure>\n<div class=\"row two\">\n";
    for (const std::string& learner : learners_) {
      std::vector<internal::Bar> bars;
      for (const Cell& cell : summary_.averages) {
        if (cell.learner != learner) continue;
        const auto commands = [&](const char* outcome, const std::string& cause = "") {
          EpisodeFilter filter = FilterOf(cell, {outcome});
          filter.cause = cause;
          return Commands({filter});
        };
        internal::Bar bar{NameOf(cell.method),
                          {{"completed", "done", cell.completed.value, commands("completed")}}};
        for (const auto& [cause, count] : cell.halt_causes) {
          bar.parts.push_back({"halted: " + cause, class_of(cause),
                               static_cast<double>(count) / cell.episodes,
                               commands("halted", cause)});
        }
        bar.parts.push_back({"collided", "hit", cell.collided.value, commands("collided")});
        bars.push_back(std::move(bar));
      }
      out_ << "<div><h3>Learner " << Escape(LearnerNameOf(learner)) << "</h3>\n"
           << internal::Bars(bars) << "</div>\n";
    }
    out_ << "</div>\n<div class=\"key\">";
    const auto key = [&](const std::string& css_class, const std::string& name) {
      out_ << "<span>" << internal::SvgSwatch(css_class) << Escape(name) << "</span>";
    };
    key("done", "completed");
    for (const std::string& cause : causes) key(class_of(cause), "halted: " + cause);
    key("hit", "collided");
    out_ << "</div>\n<figcaption>Shares of all episodes, in percent.</figcaption>\n</figure>\n";
  }

  void CollisionCauses() {
    std::set<std::string> causes;
    for (const Cell& cell : summary_.averages) {
      for (const auto& [cause, count] : cell.collision_causes) causes.insert(cause);
    }
    if (causes.empty()) return;
    out_ << "<div class=\"wide\"><table><caption>Collisions, by the source of the control that "
            "collided</caption><thead><tr><th>Learner</th><th>Method</th>";
    for (const std::string& cause : causes) out_ << "<th class=\"n\">" << Escape(cause) << "</th>";
    out_ << "</tr></thead><tbody>\n";
    std::string learner;
    for (const Cell& cell : summary_.averages) {
      StartRow(cell, learner);
      for (const std::string& cause : causes) {
        const auto found = cell.collision_causes.find(cause);
        EpisodeFilter filter = FilterOf(cell, {"collided"});
        filter.cause = cause;
        out_ << "<td class=\"n\"" << Title({filter}) << ">"
             << (found == cell.collision_causes.end() ? 0 : found->second) << "</td>";
      }
      out_ << "</tr>\n";
    }
    out_ << "</tbody></table></div>\n";
  }

  // Starts a row with the method, and with the learner if it is the first row of the learner.
  void StartRow(const Cell& cell, std::string& learner) {
    const bool first = cell.learner != learner;
    learner = cell.learner;
    out_ << (first ? "<tr class=\"first\"><td>" : "<tr><td>") << (first ? Escape(learner) : "")
         << "</td><td><span class=\"dot\" " << ColourOf(cell.method) << "></span>"
         << Escape(NameOf(cell.method)) << "</td>";
  }

  void Settings() {
    if (summary_.commit.empty() && options_.settings.empty()) return;
    out_ << "<h2>Settings</h2>\n<div class=\"wide\"><table><tbody>\n";
    const auto row = [&](const std::string& name, const std::string& value) {
      out_ << "<tr><td>" << Escape(name) << "</td><td class=\"text\"><code>" << Escape(value)
           << "</code></td></tr>\n";
    };
    if (!summary_.cells.empty()) row("seed", std::to_string(summary_.seed));
    if (!summary_.commit.empty()) row("commit", summary_.commit);
    for (const auto& [name, value] : options_.settings) row(name, value);
    out_ << "</tbody></table></div>\n";
  }

  void Cells() {
    out_ << "<h2>Every data point</h2>\n<details><summary>Show the table of "
         << summary_.cells.size()
         << " cells</summary>\n<div class=\"wide\"><table><thead><tr><th>Learner</th>"
            "<th>Method</th><th class=\"n\">Demonstrations</th><th class=\"n\">Episodes</th>"
            "<th class=\"n\">Completed, %</th><th class=\"n\">Halted, %</th>"
            "<th class=\"n\">Collided, %</th><th class=\"n\">Passed, %</th>"
            "<th class=\"n\">Mean<br>change</th>"
            "<th class=\"n\">Controls per<br>trajectory</th><th class=\"n\">Start states<br>redrawn"
            "</th></tr></thead><tbody>\n";
    const Cell* previous = nullptr;
    for (const Cell& cell : summary_.cells) {
      const bool first = previous == nullptr || cell.learner != previous->learner ||
                         cell.method != previous->method;
      previous = &cell;
      out_ << (first ? "<tr class=\"first\">" : "<tr>") << "<td>" << Escape(cell.learner)
           << "</td><td>" << Escape(NameOf(cell.method)) << "</td><td class=\"n\">"
           << cell.demonstrations << "</td><td class=\"n\">" << cell.episodes << "</td>";
      ShareCells(cell);
      InterventionCells(cell);
      out_ << "<td class=\"n\"" << Title({FilterOf(cell)}) << ">"
           << Number(cell.controls_per_trajectory, 1) << "</td><td class=\"n\">"
           << cell.redrawn_starts << "</td></tr>\n";
    }
    out_ << "</tbody></table></div>\n</details>\n";
    if (summary_.measures.empty()) return;
    out_ << "<h3>Further figures: means over trials</h3>\n<p class=\"caption\">They describe "
            "the learned models, not episodes, and are the entries \"measures\" of "
            "summary.json.</p>\n<details><summary>Show</summary>\n"
            "<div class=\"wide\"><table><thead><tr><th>Figure</th><th>Learner</th>"
            "<th class=\"n\">Demonstrations</th><th class=\"n\">Mean</th></tr></thead><tbody>\n";
    for (const MeasureMean& measure : summary_.measures) {
      out_ << "<tr><td>" << Escape(measure.name) << "</td><td>" << Escape(measure.learner)
           << "</td><td class=\"n\">" << measure.demonstrations << "</td><td class=\"n\">"
           << (std::isfinite(measure.mean) ? Number(measure.mean, 5) : "\u2013") << "</td></tr>\n";
    }
    out_ << "</tbody></table></div>\n</details>\n";
  }

  std::ostringstream out_;
};

}  // namespace

std::string RenderReport(const Summary& summary, const ReportOptions& options) {
  return Page(summary, options).Render();
}

void SaveReport(const Summary& summary, const ReportOptions& options,
                const std::filesystem::path& path) {
  core::ReplaceFile(path, RenderReport(summary, options));
}

}  // namespace dfr::experiment
