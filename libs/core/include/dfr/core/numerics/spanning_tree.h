#pragma once

#include <cstddef>
#include <vector>

#include "dfr/core/matrix.h"

namespace dfr::core {

/// Link of a minimum spanning tree: one merge of single linkage.
struct Link {
  std::size_t from = 0;     ///< Row that was already in the tree.
  std::size_t to = 0;       ///< Row that this link added.
  double length = 0.0;      ///< Euclidean distance between the two rows.
  std::size_t members = 1;  ///< Number of rows on the side of `to` after cutting the link.
};

/// Returns the minimum spanning tree of the rows of `points`, by Prim's algorithm from row 0, in
/// the order in which rows join. O(n^2 d). A link much longer than LinkMedian() separates clusters.
[[nodiscard]] std::vector<Link> SpanningTree(const Matrix& points);

/// Returns the median length of the links; 0 if there are none.
[[nodiscard]] double LinkMedian(const std::vector<Link>& links);

/// Links longer than this multiple of the median separate two clusters.
inline constexpr double kClusterGap = 3.0;

}  // namespace dfr::core
