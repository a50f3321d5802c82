#include "smo/starts.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace dfr::kernel::internal {

std::vector<double> Fill(std::span<const std::size_t> order, std::size_t count, double total) {
  std::vector<double> alpha(count, 0.0);
  for (const std::size_t i : order) {
    if (total <= 0.0) break;
    alpha[i] = std::min(1.0, total);
    total -= alpha[i];
  }
  return alpha;
}

std::vector<double> EvenlySpread(std::size_t count, double total) {
  std::vector<std::size_t> chosen(std::min(count, static_cast<std::size_t>(std::ceil(total))));
  for (std::size_t k = 0; k < chosen.size(); ++k) chosen[k] = k * count / chosen.size();
  return Fill(chosen, count, total);
}

std::vector<double> Feasible(std::span<const double> start, double total) {
  const double scale = total / std::accumulate(start.begin(), start.end(), 0.0);
  std::vector<double> alpha(start.size());
  double rest = total;
  for (std::size_t i = 0; i < alpha.size(); ++i) {
    alpha[i] = std::min({1.0, scale * start[i], rest});
    rest -= alpha[i];
  }
  // Takes existing support vectors first.
  for (const bool support : {true, false}) {
    for (std::size_t i = 0; i < alpha.size() && rest > 0.0; ++i) {
      if ((start[i] > 0.0) != support) continue;
      const double more = std::min(1.0 - alpha[i], rest);
      alpha[i] += more;
      rest -= more;
    }
  }
  return alpha;
}

}  // namespace dfr::kernel::internal
