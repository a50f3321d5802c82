#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace dfr::kernel::internal {

/// The samples that a solver moves while all others are fixed: the free samples and, at each bound,
/// those nearest to moving. Alpha moves from one bound to the other. A choice from both bounds
/// together could contain samples of one bound only, and no step would be possible.
class ActiveSet {
 public:
  /// At each bound, takes up to (`most_violators` + number of free samples) / 2 samples that
  /// violate their KKT condition, and at least `margin` / 2 others.
  ActiveSet(std::size_t margin, std::size_t most_violators)
      : margin_(margin), most_violators_(most_violators) {}

  void Choose(std::span<const double> alpha, std::span<const double> gradient, double rho);

  /// Ascending.
  [[nodiscard]] const std::vector<std::size_t>& samples() const noexcept { return samples_; }

 private:
  struct Candidate {
    double slack;  // distance from moving; negative for violators
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
