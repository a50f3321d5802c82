#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "dfr/control/constants.h"

namespace dfr::control {

/// The values of one entry of the demonstrated controls, if they are few. Examples are a gripper
/// that opens or closes, and an axis that moves at one speed or stands still. The mean of two such
/// values may be invalid.
class FewValues {
 public:
  void Add(double value) {
    ++count_;
    if (values_.size() > guided::kMostFew) return;
    const auto at = std::lower_bound(values_.begin(), values_.end(), value);
    if (at == values_.end() || *at != value) values_.insert(at, value);
  }

  /// Returns the values in ascending order; empty if there are more than guided::kMostFew, or if
  /// each occurs fewer than guided::kLeastRepeated times on average.
  [[nodiscard]] std::vector<double> values() const {
    const bool few =
        values_.size() <= guided::kMostFew && count_ >= guided::kLeastRepeated * values_.size();
    return few ? values_ : std::vector<double>{};
  }

 private:
  std::vector<double> values_;
  std::size_t count_ = 0;
};

}  // namespace dfr::control
