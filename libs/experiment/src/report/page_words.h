#pragma once

#include <optional>
#include <string>
#include <vector>

#include "dfr/experiment/episodes.h"
#include "dfr/experiment/report.h"

namespace dfr::experiment::internal {

/// Names of methods and learners on a page, colours and judgements of methods, formatted numbers,
/// and the commands that list the episodes behind the numbers. Borrows both arguments.
class PageWords {
 public:
  PageWords(const Summary& summary, const ReportOptions& options);

 protected:
  [[nodiscard]] std::string NameOf(const std::string& method) const;
  [[nodiscard]] std::string LearnerNameOf(const std::string& learner) const;
  /// Returns the style of a method. A method without a predefined style gets the first free style
  /// of the page.
  [[nodiscard]] int StyleOf(const std::string& method) const;
  [[nodiscard]] std::string ColourOf(const std::string& method) const;
  [[nodiscard]] static std::string Percent(double value, int digits);
  [[nodiscard]] static std::string Range(double low, double high, int digits);
  /// Formats the change in the number of collisions, negative for fewer collisions.
  [[nodiscard]] static std::string Change(const std::optional<double>& reduction);
  [[nodiscard]] static std::string Times(const std::optional<double>& ratio);
  /// Formats the commands that print a number and the ids of its episodes, for element attributes.
  [[nodiscard]] std::string Title(const std::vector<EpisodeFilter>& filters) const;
  [[nodiscard]] std::string Commands(const std::vector<EpisodeFilter>& filters) const;
  [[nodiscard]] static EpisodeFilter FilterOf(const Cell& cell,
                                              const std::vector<std::string>& outcomes = {});
  /// Returns a filter for the method's episodes, then a filter for its reference's episodes.
  [[nodiscard]] static std::vector<EpisodeFilter> FiltersOf(
      const Contrast& contrast, const std::vector<std::string>& outcomes = {});
  /// Returns the filter for the start states from which only the method collides, or only its
  /// reference if `reference` is true.
  [[nodiscard]] static EpisodeFilter OnlyCollided(const Contrast& contrast, bool reference);
  /// Returns the recommendation about the contrast's method, compared with the reference.
  [[nodiscard]] ReportJudgement Judge(const Contrast& contrast) const;

  const Summary& summary_;
  const ReportOptions& options_;
  std::vector<std::string> methods_;
  std::vector<std::string> learners_;
};

}  // namespace dfr::experiment::internal
