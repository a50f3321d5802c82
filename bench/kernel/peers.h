#pragma once

#include <memory>
#include <span>
#include <string>

#include "dfr/core/matrix.h"

namespace dfr::bench {

/// A one-class SVM of another library, trained on the same data with the same options, with the
/// calls that the library's documentation shows.
class Peer {
 public:
  virtual ~Peer() = default;
  /// Decides row `i` of the queries given to Prepare(), in LIBSVM's scale.
  virtual double Decide(int i) = 0;
  /// Decides every row, with the library's batch call if it has one.
  virtual void DecideAll(std::span<double> values) = 0;
  /// Converts queries to the library's format, outside the timing.
  virtual void Prepare(const core::Matrix& queries) = 0;
  [[nodiscard]] virtual int num_support_vectors() const = 0;
};

struct PeerOptions {
  double nu = 0.05;
  double gamma = 1.0;
  double tolerance = 1e-3;
};

[[gnu::visibility("default")]] std::unique_ptr<Peer> TrainLibsvm(const core::Matrix& samples,
                                                                 const PeerOptions& options);
[[gnu::visibility("default")]] std::unique_ptr<Peer> TrainOpenCv(const core::Matrix& samples,
                                                                 const PeerOptions& options);
[[gnu::visibility("default")]] std::unique_ptr<Peer> TrainDlib(const core::Matrix& samples,
                                                               const PeerOptions& options);
/// An untrained peer: the sum in plain Eigen over given support vectors, with alpha in LIBSVM's
/// scale.
[[gnu::visibility("default")]] std::unique_ptr<Peer> PlainEigen(const core::Matrix& support_vectors,
                                                                const Eigen::VectorXd& alpha,
                                                                double gamma, double rho);

/// Returns alpha' K alpha / 2 of LIBSVM's solution, in double from its alpha.
[[gnu::visibility("default")]] double LibsvmObjective(const Peer& libsvm);

}  // namespace dfr::bench
