#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace dfr::kernel::internal {

/// The samples that a solver moves while all others are fixed: the free ones, and of those at each
/// bound the ones nearest to moving. Alpha moves from one bound to the other; chosen from both
/// together, the nearest may all be of one kind, and nothing could move.
class ActiveSet {
 public:
  /// Takes of each kind at least `margin` / 2 samples more than violate their KKT condition, of
  /// which `most_violators` / 2 or as many as half of the free samples are taken.
  ActiveSet(std::size_t margin, std::size_t most_violators)
      : margin_(margin), most_violators_(most_violators) {}

  void Choose(std::span<const double> alpha, std::span<const double> gradient, double rho);

  /// Ascending.
  [[nodiscard]] const std::vector<std::size_t>& samples() const noexcept { return samples_; }

 private:
  struct Candidate {
    double slack;  // how far it is from moving; violators are below zero
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
