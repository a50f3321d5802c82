#include "dfr/core/numerics/spanning_tree.h"

#include <limits>

#include "dfr/core/numerics/quantile.h"

namespace dfr::core {

std::vector<Link> SpanningTree(const Matrix& points) {
  const auto n = static_cast<std::size_t>(points.rows());
  std::vector<Link> links;
  if (n == 0) return links;
  links.reserve(n - 1);
  std::vector<double> distance(n, std::numeric_limits<double>::infinity());
  std::vector<std::size_t> parent(n, 0);
  std::vector<bool> joined(n, false);
  joined[0] = true;
  std::size_t last = 0;
  while (links.size() + 1 < n) {
    std::size_t next = n;
    for (std::size_t i = 0; i < n; ++i) {
      if (joined[i]) continue;
      const double d =
          (points.row(static_cast<Eigen::Index>(i)) - points.row(static_cast<Eigen::Index>(last)))
              .norm();
      if (d < distance[i]) {
        distance[i] = d;
        parent[i] = last;
      }
      if (next == n || distance[i] < distance[next]) next = i;
    }
    joined[next] = true;
    links.push_back({.from = parent[next], .to = next, .length = distance[next]});
    last = next;
  }
  // In reverse order, each row is visited before the row to which it is attached.
  std::vector<std::size_t> members(n, 1);
  for (auto link = links.rbegin(); link != links.rend(); ++link) {
    link->members = members[link->to];
    members[link->from] += members[link->to];
  }
  return links;
}

double LinkMedian(const std::vector<Link>& links) {
  if (links.empty()) return 0.0;
  std::vector<double> lengths;
  lengths.reserve(links.size());
  for (const Link& link : links) lengths.push_back(link.length);
  return Median(lengths);
}

}  // namespace dfr::core
