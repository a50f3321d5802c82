#include "dfr/reduction/row_source.h"

#include <algorithm>

#include "dfr/core/contract.h"

namespace dfr::reduction {

MatrixRows::MatrixRows(std::span<const core::Matrix> matrices) : matrices_(matrices), begin_{0} {
  for (std::size_t i = 0; i < matrices.size(); ++i) {
    DFR_THROW_UNLESS(matrices[i].cols() == matrices[0].cols(),
                     "matrix " << i << " has " << matrices[i].cols()
                               << " columns, but matrix 0 has " << matrices[0].cols());
    begin_.push_back(begin_.back() + matrices[i].rows());
  }
  DFR_THROW_UNLESS(begin_.back() > 0 && matrices[0].cols() > 0, "there are no rows to reduce");
}

void MatrixRows::Read(Eigen::Index first, Eigen::Ref<core::Matrix> block) const {
  auto matrix = static_cast<std::size_t>(std::upper_bound(begin_.begin(), begin_.end(), first) -
                                         begin_.begin() - 1);
  for (Eigen::Index done = 0; done < block.rows(); ++matrix) {
    const Eigen::Index from = first + done - begin_[matrix];
    const Eigen::Index count = std::min(matrices_[matrix].rows() - from, block.rows() - done);
    block.middleRows(done, count) = matrices_[matrix].middleRows(from, count);
    done += count;
  }
}

}  // namespace dfr::reduction
