#include "report/page_words.h"

#include <algorithm>
#include <set>

#include "report/html.h"
#include "report/svg_plot.h"

namespace dfr::experiment::internal {

PageWords::PageWords(const Summary& summary, const ReportOptions& options)
    : summary_(summary), options_(options) {
  for (const Cell& cell : summary.averages) {
    if (std::find(methods_.begin(), methods_.end(), cell.method) == methods_.end()) {
      methods_.push_back(cell.method);
    }
    if (std::find(learners_.begin(), learners_.end(), cell.learner) == learners_.end()) {
      learners_.push_back(cell.learner);
    }
  }
  for (const ReportJudgement& judged : options.judgements) {
    if (std::ranges::count(methods_, judged.method) == 0) methods_.push_back(judged.method);
  }
}

std::string PageWords::NameOf(const std::string& method) const {
  const auto named = options_.method_names.find(method);
  if (named != options_.method_names.end()) return named->second;
  for (const NamedStyle& style : NamedStyles()) {
    if (style.method == method) return std::string(style.name);
  }
  return method;
}

std::string PageWords::LearnerNameOf(const std::string& learner) const {
  const auto named = options_.learner_names.find(learner);
  return named != options_.learner_names.end() ? named->second : learner;
}

int PageWords::StyleOf(const std::string& method) const {
  int style = MethodStyle(method);
  if (style >= 0) return style;
  std::set<int> taken = {0};  // style of the reference
  for (const std::string& other : methods_) taken.insert(MethodStyle(other));
  for (const std::string& other : methods_) {
    if (MethodStyle(other) >= 0) continue;
    do ++style;
    while (taken.contains(style));
    if (other == method) break;
  }
  return style;
}

std::string PageWords::ColourOf(const std::string& method) const {
  return StyleAttribute(StyleOf(method));
}

std::string PageWords::Percent(double value, int digits) {
  return Number(100.0 * value, digits) + "\u2009%";
}

std::string PageWords::Range(double low, double high, int digits) {
  std::string text = "[";
  text += Number(100.0 * low, digits);
  text += ", ";
  text += Number(100.0 * high, digits);
  text += "]";
  return text;
}

std::string PageWords::Change(const std::optional<double>& reduction) {
  if (!reduction) return "\u2013";
  std::string text = *reduction < 0.0 ? "+" : "";
  text += Percent(-*reduction, 0);
  return text;
}

std::string PageWords::Times(const std::optional<double>& ratio) {
  if (!ratio) return "\u2013";
  return Number(*ratio, *ratio < 10.0 ? 2 : 1) + "\u2009\u00d7";
}

std::string PageWords::Title(const std::vector<EpisodeFilter>& filters) const {
  const std::string commands = Commands(filters);
  return commands.empty() ? "" : " title=\"" + Escape(commands) + "\"";
}

std::string PageWords::Commands(const std::vector<EpisodeFilter>& filters) const {
  std::string commands;
  if (options_.program.empty()) return commands;
  for (const EpisodeFilter& filter : filters) {
    if (!commands.empty()) commands += '\n';
    commands += EpisodesCommand(options_.program, filter);
  }
  return commands;
}

EpisodeFilter PageWords::FilterOf(const Cell& cell, const std::vector<std::string>& outcomes) {
  return {.method = cell.method,
          .learner = cell.learner,
          .demonstrations = cell.demonstrations,
          .outcomes = outcomes};
}

std::vector<EpisodeFilter> PageWords::FiltersOf(const Contrast& contrast,
                                                const std::vector<std::string>& outcomes) {
  return {{.method = contrast.method, .learner = contrast.learner, .outcomes = outcomes},
          {.method = contrast.against, .learner = contrast.learner, .outcomes = outcomes}};
}

EpisodeFilter PageWords::OnlyCollided(const Contrast& contrast, bool reference) {
  const std::string& one = reference ? contrast.against : contrast.method;
  const std::string& other = reference ? contrast.method : contrast.against;
  return {.method = one,
          .learner = contrast.learner,
          .outcomes = {"collided"},
          .against = {.method = other, .outcomes = {"completed", "halted"}}};
}

ReportJudgement PageWords::Judge(const Contrast& contrast) const {
  const std::string& method = contrast.method;
  const PairedContrast& ratios = contrast.ratios;
  const auto& fewer = ratios.collision_reduction_interval;
  const auto& completes = ratios.completion_ratio_interval;
  const std::string numbers = Change(ratios.collision_reduction) + " collisions, " +
                              Times(ratios.completion_ratio) + " completions";
  if (fewer && fewer->high < 0.0) return {method, 2, numbers + ": it collides more often"};
  if (ratios.completion_ratio && *ratios.completion_ratio < 0.5) {
    return {method, 2, numbers + ": it completes less than half as often"};
  }
  if (!fewer || fewer->low <= 0.0) return {method, 1, numbers + ": fewer collisions are not shown"};
  if (!completes || completes->low < 0.9) {
    return {method, 1, numbers + ": 0.9 times the completions is not shown"};
  }
  if (contrast.clusters == "episodes") {
    return {method, 1, numbers + ": too few trials to estimate how they vary"};
  }
  return {method, 0, numbers};
}

}  // namespace dfr::experiment::internal
