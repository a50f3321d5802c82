#pragma once

#include <memory>
#include <span>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "dfr/kernel/one_class_svm.h"

struct svm_model;
struct svm_node;

namespace dfr::kernel::test {

/// LIBSVM's one-class SVM with the Gaussian kernel, as the peer that ours is compared with.
class LibsvmPeer {
 public:
  LibsvmPeer(const core::Matrix& samples, double nu, double gamma, double tolerance);
  ~LibsvmPeer();
  LibsvmPeer(const LibsvmPeer&) = delete;
  LibsvmPeer& operator=(const LibsvmPeer&) = delete;

  /// In LIBSVM's scale: nu m times ours.
  [[nodiscard]] double Decision(std::span<const double> x) const;
  [[nodiscard]] double rho() const;
  [[nodiscard]] int num_support_vectors() const;
  /// alpha' K alpha / 2 from the alpha it returned.
  [[nodiscard]] double Objective() const;
  [[nodiscard]] const svm_model* model() const { return model_; }

 private:
  std::vector<svm_node> nodes_;
  svm_model* model_ = nullptr;
};

/// States on a curved tube, as trajectories of a robot are: `n` entries, each a sine of a common
/// phase, plus noise of 0.1.
[[nodiscard]] core::Matrix Tube(int m, int n, core::Random& random);

/// g of every row.
[[nodiscard]] inline Eigen::VectorXd Decisions(const OneClassSvm& svm,
                                               const core::Matrix& queries) {
  Eigen::VectorXd g(queries.rows());
  for (Eigen::Index i = 0; i < queries.rows(); ++i) g[i] = svm.Decision(core::Row(queries, i));
  return g;
}

}  // namespace dfr::kernel::test
