#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace dfr::kernel::internal {

/// The samples that a solver moves while all others are fixed: all free samples and, at each bound,
/// the samples nearest to moving. Each bound is treated separately: a step raises one alpha and
/// lowers another, which is impossible if all chosen samples are at the same bound.
class ActiveSet {
 public:
  /// At each bound, chooses up to (`most_violators` + number of free samples) / 2 samples that
  /// violate their KKT condition, and the next `margin` / 2 or more in order of slack.
  ActiveSet(std::size_t margin, std::size_t most_violators)
      : margin_(margin), most_violators_(most_violators) {}

  void Choose(std::span<const double> alpha, std::span<const double> gradient, double rho);

  /// Returns the indices of the chosen samples, ascending.
  [[nodiscard]] const std::vector<std::size_t>& samples() const noexcept { return samples_; }

 private:
  struct Candidate {
    double slack;  // distance of G from rho in the KKT condition, negative for violators
    std::size_t sample;
  };
  void AddNearest(std::vector<Candidate>& candidates, std::size_t free);

  std::size_t margin_;
  std::size_t most_violators_;
  std::vector<std::size_t> samples_;
  std::vector<Candidate> empty_;
  std::vector<Candidate> full_;
};

}  // namespace dfr::kernel::internal
