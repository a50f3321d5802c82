#pragma once

#include <memory>
#include <span>
#include <vector>

namespace dfr::bench {

/// A network of tanh layers in idiomatic Eigen, compiled for this machine. Its Eigen allocates
/// memory differently from ours. The interface therefore contains no Eigen types. Matrices are in
/// row-major order.
class [[gnu::visibility("default")]] EigenMlp {
 public:
  struct Layer {
    int inputs;
    int outputs;
    const double* weights;  // inputs x outputs
    const double* biases;
  };
  explicit EigenMlp(std::span<const Layer> layers);
  ~EigenMlp();
  EigenMlp(const EigenMlp&) = delete;
  EigenMlp& operator=(const EigenMlp&) = delete;

  /// Returns the outputs of `rows` samples, valid until the next call.
  const double* Forward(const double* inputs, int rows);
  /// Computes gradient() after Forward() of the same inputs.
  void Backward(const double* inputs, const double* output_gradient, int rows);
  [[nodiscard]] std::vector<double> gradient() const;

 private:
  struct Network;
  std::unique_ptr<Network> network_;
};

}  // namespace dfr::bench
