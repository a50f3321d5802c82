#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "gaussian/gaussian_sum.h"
#include "gaussian/gaussian_terms.h"
#include "smo/smo_loop.h"

namespace dfr::kernel::internal {

/// Below this total, 16 MiB for all rows, reading a row is faster than computing it.
inline constexpr double kQuickCacheBytes = 16.0 * 0x1p20;
/// From this dimension on, computing a row takes longer than reading it from memory.
inline constexpr std::size_t kManyFeatures = 16;

/// Cache of kernel matrix rows, computed on demand. A full cache evicts a row that has not been
/// used since the hand last passed it (clock algorithm).
template <typename T>
class RowStore {
 public:
  explicit RowStore(double budget_bytes) : budget_bytes_(budget_bytes) {}

  void Reset(const GaussianTerms<T>& terms) {
    terms_ = &terms;
    stride_ = terms.row_size();
    query_.resize(terms.dim);
    const double row_bytes = static_cast<double>(stride_ * sizeof(T));
    const double all = row_bytes * static_cast<double>(terms.count);
    const bool keep = all <= kQuickCacheBytes || terms.dim >= kManyFeatures;
    const double fit = keep ? std::min(budget_bytes_ / row_bytes, 1e9) : 0.0;
    // A step uses two rows. A third slot leaves room for the next row.
    capacity_ = std::min(terms.count, std::max<std::size_t>(3, static_cast<std::size_t>(fit)));
    if (values_.size() < capacity_ * stride_) {
      values_.clear();  // no content to copy
      values_.resize(capacity_ * stride_);
    }
    known_.assign(terms.count, nullptr);
    used_.assign(terms.count, 0);
    owner_.assign(capacity_, kNone);
    hand_ = 0;
  }

  [[nodiscard]] RowTable<T> Table() {
    const auto compute = [](void* store, std::size_t i, std::size_t keep) {
      return static_cast<RowStore*>(store)->Compute(i, keep);
    };
    return {known_.data(), used_.data(), compute, this};
  }

  [[nodiscard]] std::int64_t evaluations() const { return evaluations_; }

 private:
  static constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();

  const T* Compute(std::size_t i, std::size_t keep) {
    while (owner_[hand_] != kNone && (used_[owner_[hand_]] != 0 || owner_[hand_] == keep)) {
      used_[owner_[hand_]] = 0;
      hand_ = (hand_ + 1) % capacity_;
    }
    T* row = values_.data() + hand_ * stride_;
    if (owner_[hand_] != kNone) known_[owner_[hand_]] = nullptr;
    owner_[hand_] = i;
    known_[i] = row;
    hand_ = (hand_ + 1) % capacity_;
    terms_->Point(i, query_.data());
    GaussianRow(*terms_, query_.data(), row);
    evaluations_ += static_cast<std::int64_t>(terms_->count);
    return row;
  }

  double budget_bytes_;
  const GaussianTerms<T>* terms_ = nullptr;
  std::size_t stride_ = 0;
  std::size_t capacity_ = 0;
  std::size_t hand_ = 0;
  std::vector<T> query_;
  AlignedVector<T> values_;
  std::vector<const T*> known_;
  std::vector<unsigned char> used_;
  std::vector<std::size_t> owner_;  // index of the row in each slot
  std::int64_t evaluations_ = 0;
};

}  // namespace dfr::kernel::internal
