#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "dfr/core/files/archive.h"
#include "dfr/core/matrix.h"
#include "dfr/core/random.h"

namespace dfr::imitation {

/// A batch: one sample per row, without a copy if the rows are contiguous.
using Rows = Eigen::Ref<const core::Matrix>;

/// Multi-layer perceptron: tanh hidden layers, a linear output layer,
///   h_0 = x,  h_l = tanh(W_l' h_{l-1} + b_l),  y = W_L' h_{L-1} + b_L.
///
/// All weights and biases are one flat vector theta for the optimisers: per layer first W_l (inputs
/// x outputs, row-major), then b_l.
///
/// Batched calls take a Workspace, which grows to the largest batch and is then reused: loops over
/// batches of one size do not allocate. Each sample's result is bit-identical to the result of
/// a batch with this sample alone. Sums over a batch depend, within rounding, on the order of its
/// samples. The kernels use the widest instruction set of the machine: results of different
/// machines differ by rounding.
///
/// Const calls are safe from several threads, each with its own workspace.
class Mlp {
 public:
  /// Maximum number of units per layer: one sample's activations must fit on the stack.
  static constexpr int kMaxWidth = 1024;

  /// Offsets of a layer's parameters.
  struct Layer {
    int inputs;
    int outputs;
    Eigen::Index weights;  ///< Offset of the weights, inputs x outputs, row-major.
    Eigen::Index biases;   ///< Offset of the biases, one per output.
  };

  /// Buffers of the batched calls, including the activations that Forward() stores for later calls.
  class Workspace {
   public:
    Workspace() = default;

   private:
    friend class Mlp;
    std::vector<std::vector<double>> activations_;  // per hidden layer, samples x units
    std::vector<double> outputs_;
    std::vector<double> tangents_;
    std::vector<double> transposed_;  // weights of all layers, outputs x inputs
    std::vector<double> front_;       // derivatives of one chunk at a layer and at the next
    std::vector<double> back_;
    Eigen::Index samples_ = 0;
  };

  /// Creates a network with zero parameters. `sizes`: inputs, units of each hidden layer, outputs.
  /// @throws std::invalid_argument if there are fewer than two sizes, or one is not in [1,
  /// kMaxWidth].
  explicit Mlp(std::vector<int> sizes);

  /// Creates a network with random weights. Biases are zero. Weights are normal with variance
  /// 1/inputs of their layer (LeCun et al., 1998); `output_scale` multiplies the weights of the
  /// output layer. The same random stream gives the same network.
  Mlp(std::vector<int> sizes, core::Random& random, double output_scale = 1.0);

  [[nodiscard]] const std::vector<int>& sizes() const noexcept { return sizes_; }
  [[nodiscard]] int input_dim() const noexcept { return sizes_.front(); }
  [[nodiscard]] int output_dim() const noexcept { return sizes_.back(); }
  /// Returns the hidden layers, followed by the output layer.
  [[nodiscard]] const std::vector<Layer>& layers() const noexcept { return layers_; }
  [[nodiscard]] Eigen::Index num_parameters() const noexcept { return parameters_.size(); }

  [[nodiscard]] const Eigen::VectorXd& parameters() const noexcept { return parameters_; }
  /// @throws std::invalid_argument unless there are num_parameters() finite entries.
  void SetParameters(const Eigen::Ref<const Eigen::VectorXd>& parameters);

  /// Computes y for one x. Never allocates. @pre x.size() == input_dim(), y.size() == output_dim()
  void Forward(std::span<const double> x, std::span<double> y) const noexcept;

  /// Returns the outputs (n x output_dim()) for n inputs (n x input_dim()). Valid until the
  /// workspace's next use.
  /// @throws std::invalid_argument if the inputs have another number of columns.
  Eigen::Map<const core::Matrix> Forward(const Rows& inputs, Workspace& workspace) const;

  /// Computes the gradient of a loss with respect to the parameters from its gradient with respect
  /// to the outputs (n x output_dim()). Requires Forward() of the same `inputs` with the same
  /// parameters first.
  /// @param gradient  num_parameters() entries, overwritten.
  /// @throws std::invalid_argument for shapes that do not fit the network or the last Forward().
  void Backward(const Rows& inputs, const Rows& output_gradient, Workspace& workspace,
                Eigen::VectorXd& gradient) const;

  /// Returns the derivative of the outputs (n x output_dim()) along `direction` in parameter space.
  /// Requires Forward() first, as Backward() does. Valid until the workspace's next use.
  Eigen::Map<const core::Matrix> Tangent(const Rows& inputs,
                                         const Eigen::Ref<const Eigen::VectorXd>& direction,
                                         Workspace& workspace) const;

  /// Writes to row i * output_dim() + o the gradient of output o of sample i with respect to the
  /// parameters. Requires Forward() first, as Backward() does. Fast only for small networks.
  void Jacobian(const Rows& inputs, Workspace& workspace, Eigen::Ref<core::Matrix> jacobian) const;

  /// Appends sizes and parameters. A reader restores them bit for bit.
  void Save(core::ArchiveWriter& archive) const;
  /// @throws std::runtime_error naming the file if the data are not a valid network.
  static Mlp Load(core::ArchiveReader& archive);

 private:
  [[nodiscard]] const double* at(Eigen::Index offset) const noexcept {
    return parameters_.data() + offset;
  }
  void CheckAfterForward(const Rows& inputs, const Workspace& workspace) const;
  void Transpose(Workspace& workspace) const;

  std::vector<int> sizes_;
  std::vector<Layer> layers_;
  int width_ = 0;  // widest layer, including inputs and outputs
  Eigen::VectorXd parameters_;
};

}  // namespace dfr::imitation
