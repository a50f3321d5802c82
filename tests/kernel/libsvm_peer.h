#pragma once

#include <span>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "dfr/kernel/one_class_svm.h"

struct svm_model;
struct svm_node;

namespace dfr::kernel::test {

/// LIBSVM's one-class SVM with the Gaussian kernel, for comparison with OneClassSvm.
class LibsvmPeer {
 public:
  LibsvmPeer(const core::Matrix& samples, double nu, double gamma, double tolerance);
  ~LibsvmPeer();
  LibsvmPeer(const LibsvmPeer&) = delete;
  LibsvmPeer& operator=(const LibsvmPeer&) = delete;

  /// Returns the decision value in LIBSVM's scale, nu m times g.
  [[nodiscard]] double Decision(std::span<const double> x) const;
  [[nodiscard]] double rho() const;
  [[nodiscard]] int num_support_vectors() const;
  /// Computes alpha' K alpha / 2 from LIBSVM's alpha.
  [[nodiscard]] double Objective() const;
  [[nodiscard]] const svm_model* model() const { return model_; }

 private:
  std::vector<svm_node> nodes_;
  svm_model* model_ = nullptr;
};

/// Returns states on a curved tube, like trajectories of a robot. Each of `n` entries is a sine of
/// a common phase plus noise of 0.1.
[[nodiscard]] core::Matrix Tube(int m, int n, core::Random& random);

/// Returns g of every row.
[[nodiscard]] inline Eigen::VectorXd Decisions(const OneClassSvm& svm,
                                               const core::Matrix& queries) {
  Eigen::VectorXd g(queries.rows());
  for (Eigen::Index i = 0; i < queries.rows(); ++i) g[i] = svm.Decision(core::Row(queries, i));
  return g;
}

}  // namespace dfr::kernel::test
