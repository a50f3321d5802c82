#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <tuple>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"
#include "gaussian/gaussian_terms.h"
#include "smo/smo_loop.h"

namespace dfr::kernel::internal {

/// Squared distances from each sample to all others, computed by row on demand. Fits with different
/// gamma or nu share them. Not thread-safe.
template <typename T>
class Distances {
 public:
  explicit Distances(const core::Matrix& samples);

  /// row[j] = exp(-gamma |x_i - x_j|^2), row_size() entries.
  void KernelRow(std::size_t i, double gamma, T* row);

  [[nodiscard]] std::span<const double> center() const { return terms_.center; }

 private:
  GaussianTerms<T> terms_;
  AlignedVector<T> exponents_;  // -|x_i - x_j|^2, in rows of terms_
  std::vector<unsigned char> known_;
  std::vector<T> point_;
};

/// Distances in float and in double, created when first needed. `samples` must outlive this object.
class SharedDistances {
 public:
  explicit SharedDistances(const core::Matrix& samples) : samples_(samples) {}
  template <typename T>
  [[nodiscard]] Distances<T>& In() {
    auto& distances = std::get<std::optional<Distances<T>>>(distances_);
    if (!distances) distances.emplace(samples_);
    return *distances;
  }

 private:
  const core::Matrix& samples_;
  std::tuple<std::optional<Distances<float>>, std::optional<Distances<double>>> distances_;
};

/// State that consecutive fits share: memory, and distances if their samples are the same. Not
/// thread-safe.
class Scratch {
 public:
  explicit Scratch(SharedDistances* distances = nullptr) : distances_(distances) {}
  [[nodiscard]] bool has_distances() const noexcept { return distances_ != nullptr; }
  template <typename T>
  [[nodiscard]] Distances<T>* DistancesIn() {
    return distances_ == nullptr ? nullptr : &distances_->In<T>();
  }
  /// Returns uninitialised memory for `size` entries.
  template <typename T>
  [[nodiscard]] T* Room(std::size_t size) {
    auto& room = std::get<AlignedVector<T>>(room_);
    if (room.size() < size) {
      room.clear();
      room.resize(size);
    }
    return room.data();
  }
  /// Size of the memory that Room() has allocated, in bytes.
  [[nodiscard]] std::size_t bytes() const noexcept {
    return std::get<0>(room_).size() * sizeof(float) + std::get<1>(room_).size() * sizeof(double);
  }

 private:
  SharedDistances* distances_;
  std::tuple<AlignedVector<float>, AlignedVector<double>> room_;
};

/// A dual problem with the whole kernel matrix in memory, in T. It needs no active set and never
/// evicts rows; the exact gradient is a sum of existing rows.
template <typename T>
class SmallProblem {
 public:
  /// Returns true if the matrix fits in `memory_mib` and reading it is faster than recomputing it.
  /// Shared distances count as a second matrix.
  [[nodiscard]] static bool Fits(const core::Matrix& samples, const OneClassSvmOptions& options,
                                 const Scratch& scratch);

  /// All arguments must outlive the problem, and no other problem may use `scratch` meanwhile.
  SmallProblem(const core::Matrix& samples, const Extent& extent, const OneClassSvmOptions& options,
               Scratch& scratch, FitSummary& summary);

  /// Solves from a feasible `start`; empty: from a start that needs few steps. Writes reason,
  /// iterations, gap and objective to the summary.
  void Run(std::span<const double> start);

  [[nodiscard]] std::span<const double> alpha() const { return alpha_; }
  [[nodiscard]] std::span<const double> gradient() const {
    return {gradient_.data(), alpha_.size()};
  }
  [[nodiscard]] std::int64_t evaluations() const { return evaluations_; }
  [[nodiscard]] std::span<const double> center() const {
    return distances_ != nullptr ? distances_->center() : std::span<const double>(terms_->center);
  }

 private:
  // Inverse curvatures of all rows are stored if they fit in L2 and the memory limit is high
  // enough.
  static constexpr std::size_t kMostInverseBytes = std::size_t{1} << 18;
  static constexpr double kLeastInverseMib = 2.0;

  const T* Row(std::size_t i);
  void UpdateGradient();
  [[nodiscard]] bool FewNeighbors() const;
  void StartEqual();
  void StartAtBound();
  void ChooseStart();

  const OneClassSvmOptions& options_;
  FitSummary& summary_;
  Distances<T>* distances_;
  std::optional<GaussianTerms<T>> terms_;  // empty if distances_ is set
  SmoFunctions<T> smo_;
  std::size_t row_size_;
  bool invert_;
  T* rows_;
  std::vector<const T*> known_;
  std::vector<unsigned char> used_;
  std::vector<T> point_;
  std::vector<double> alpha_;
  std::vector<std::size_t> support_;  // indices of alpha_ > 0, ascending
  AlignedVector<double> gradient_;
  std::int64_t evaluations_ = 0;
};

}  // namespace dfr::kernel::internal
