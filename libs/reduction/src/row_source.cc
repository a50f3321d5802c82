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

ByteRows::ByteRows(std::span<const std::uint8_t> bytes, Eigen::Index width)
    : bytes_(bytes), width_(width) {
  DFR_THROW_UNLESS(width > 0 && !bytes.empty(), "there are no rows to reduce");
  DFR_THROW_UNLESS(static_cast<Eigen::Index>(bytes.size()) % width == 0,
                   bytes.size() << " bytes are not a whole number of rows of " << width);
}

void ByteRows::Read(Eigen::Index first, Eigen::Ref<core::Matrix> block) const {
  using Bytes = Eigen::Matrix<std::uint8_t, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  block =
      Eigen::Map<const Bytes>(bytes_.data() + first * width_, block.rows(), width_).cast<double>();
}

}  // namespace dfr::reduction
