#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "dfr/core/matrix.h"

namespace dfr::reduction {

/// Rows of one high-dimensional block: pictures, embeddings, tactile arrays. A fit reads all of
/// them several times, in blocks and in ascending order. A source may therefore read from a file
/// that does not fit into memory.
class RowSource {
 public:
  virtual ~RowSource() = default;
  /// Number of rows.
  [[nodiscard]] virtual Eigen::Index rows() const noexcept = 0;
  /// Number of entries of a row.
  [[nodiscard]] virtual Eigen::Index width() const noexcept = 0;
  /// Copies rows first, ..., first + block.rows() - 1 to `block`, which has width() columns. A fit
  /// calls Read() from one thread. A row must have the same values at each call. The fit forwards
  /// exceptions.
  virtual void Read(Eigen::Index first, Eigen::Ref<core::Matrix> block) const = 0;
};

/// Rows of several matrices, one matrix after the other. Borrows the matrices.
class MatrixRows final : public RowSource {
 public:
  /// @throws std::invalid_argument if there is no row or widths differ.
  explicit MatrixRows(std::span<const core::Matrix> matrices);

  [[nodiscard]] Eigen::Index rows() const noexcept override { return begin_.back(); }
  [[nodiscard]] Eigen::Index width() const noexcept override { return matrices_[0].cols(); }
  void Read(Eigen::Index first, Eigen::Ref<core::Matrix> block) const override;

 private:
  std::span<const core::Matrix> matrices_;
  std::vector<Eigen::Index> begin_;  ///< First row of each matrix; then the number of rows.
};

}  // namespace dfr::reduction
