#include "dfr/imitation/mlp.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstddef>

#include "dfr/core/contract.h"
#include "mlp/dense_kernels.h"
#include "mlp/spend_weights.h"

namespace dfr::imitation {
namespace {

using internal::Multiply;
using internal::Tanh;
using internal::TimesTanhSlope;

// Number of samples that pass through all layers together, which keeps their activations in the
// first-level cache. A multiple of the tile rows of the kernels.
constexpr Eigen::Index kChunk = 96;

constexpr double kOne = 1.0;

void Grow(std::vector<double>& buffer, Eigen::Index rows, Eigen::Index cols) {
  const auto size = static_cast<std::size_t>(rows * cols);
  if (buffer.size() < size) buffer.resize(size);
}

std::size_t Entries(Eigen::Index rows, int cols) {
  return static_cast<std::size_t>(rows) * static_cast<std::size_t>(cols);
}

}  // namespace

Mlp::Mlp(std::vector<int> sizes) : sizes_(std::move(sizes)) {
  DFR_THROW_UNLESS(sizes_.size() >= 2,
                   "a network needs at least two sizes, inputs and outputs, not " << sizes_.size());
  Eigen::Index offset = 0;
  for (std::size_t i = 0; i < sizes_.size(); ++i) {
    DFR_THROW_UNLESS(sizes_[i] >= 1 && sizes_[i] <= kMaxWidth,
                     "layer " << i << " of a network has " << sizes_[i] << " units; 1 to "
                              << kMaxWidth << " are supported");
    width_ = std::max(width_, sizes_[i]);
    if (i == 0) continue;
    const Eigen::Index weights = offset;
    const Eigen::Index biases = weights + Eigen::Index{sizes_[i - 1]} * sizes_[i];
    layers_.push_back({sizes_[i - 1], sizes_[i], weights, biases});
    offset = biases + sizes_[i];
  }
  parameters_ = Eigen::VectorXd::Zero(offset);
}

Mlp::Mlp(std::vector<int> sizes, core::Random& random, double output_scale)
    : Mlp(std::move(sizes)) {
  for (const Layer& layer : layers_) {
    const double scale =
        (&layer == &layers_.back() ? output_scale : 1.0) / std::sqrt(double{1.0} * layer.inputs);
    for (Eigen::Index i = layer.weights; i < layer.biases; ++i) {
      parameters_[i] = scale * random.Normal();
    }
  }
}

void Mlp::SetParameters(const Eigen::Ref<const Eigen::VectorXd>& parameters) {
  DFR_THROW_UNLESS(parameters.size() == num_parameters(), "the network has " << num_parameters()
                                                                             << " parameters, not "
                                                                             << parameters.size());
  for (Eigen::Index i = 0; i < parameters.size(); ++i) {
    DFR_THROW_UNLESS(std::isfinite(parameters[i]),
                     "network parameter " << i << " is " << parameters[i]);
  }
  parameters_ = parameters;
}

void Mlp::Forward(std::span<const double> x, std::span<double> y) const noexcept {
  assert(static_cast<int>(x.size()) == input_dim() && static_cast<int>(y.size()) == output_dim());
  std::array<double, kMaxWidth> buffers[2];
  const double* from = x.data();
  for (std::size_t l = 0; l < layers_.size(); ++l) {
    const Layer& layer = layers_[l];
    const bool last = l + 1 == layers_.size();
    double* const to = last ? y.data() : buffers[l % 2].data();
    Multiply({.m = 1,
              .n = layer.outputs,
              .k = layer.inputs,
              .a = from,
              .a_row = 0,
              .a_col = 1,
              .b = at(layer.weights),
              .b_row = layer.outputs,
              .c = to,
              .c_row = layer.outputs,
              .bias = at(layer.biases)});
    if (!last) Tanh(to, Entries(1, layer.outputs));
    from = to;
  }
}

Eigen::Map<const core::Matrix> Mlp::Forward(const Rows& inputs, Workspace& workspace) const {
  DFR_THROW_UNLESS(inputs.cols() == input_dim(),
                   "the network takes " << input_dim() << " inputs, not " << inputs.cols());
  const Eigen::Index samples = inputs.rows();
  workspace.samples_ = samples;
  workspace.activations_.resize(layers_.size() - 1);
  for (std::size_t l = 0; l + 1 < layers_.size(); ++l) {
    Grow(workspace.activations_[l], samples, layers_[l].outputs);
  }
  Grow(workspace.outputs_, samples, output_dim());

  for (Eigen::Index first = 0; first < samples; first += kChunk) {
    const Eigen::Index rows = std::min(kChunk, samples - first);
    const double* from = inputs.data() + first * inputs.outerStride();
    std::ptrdiff_t from_row = inputs.outerStride();
    for (std::size_t l = 0; l < layers_.size(); ++l) {
      const Layer& layer = layers_[l];
      const bool last = l + 1 == layers_.size();
      double* const to =
          (last ? workspace.outputs_ : workspace.activations_[l]).data() + first * layer.outputs;
      Multiply({.m = static_cast<int>(rows),
                .n = layer.outputs,
                .k = layer.inputs,
                .a = from,
                .a_row = from_row,
                .a_col = 1,
                .b = at(layer.weights),
                .b_row = layer.outputs,
                .c = to,
                .c_row = layer.outputs,
                .bias = at(layer.biases)});
      if (!last) Tanh(to, Entries(rows, layer.outputs));
      from = to;
      from_row = layer.outputs;
    }
  }
  return {workspace.outputs_.data(), samples, output_dim()};
}

void Mlp::CheckAfterForward(const Rows& inputs, const Workspace& workspace) const {
  DFR_THROW_UNLESS(inputs.cols() == input_dim() && inputs.rows() == workspace.samples_ &&
                       workspace.activations_.size() + 1 == layers_.size(),
                   "inputs are " << inputs.rows() << " x " << inputs.cols()
                                 << ", but those of the last Forward() of this network were "
                                 << workspace.samples_ << " x " << input_dim());
}

void Mlp::Transpose(Workspace& workspace) const {
  Grow(workspace.transposed_, num_parameters(), 1);
  for (const Layer& layer : layers_) {
    Eigen::Map<core::Matrix>(workspace.transposed_.data() + layer.weights, layer.outputs,
                             layer.inputs) =
        Eigen::Map<const core::Matrix>(at(layer.weights), layer.inputs, layer.outputs).transpose();
  }
}

void Mlp::Backward(const Rows& inputs, const Rows& output_gradient, Workspace& workspace,
                   Eigen::VectorXd& gradient) const {
  CheckAfterForward(inputs, workspace);
  DFR_THROW_UNLESS(
      output_gradient.rows() == workspace.samples_ && output_gradient.cols() == output_dim(),
      "the gradient with respect to the outputs is "
          << output_gradient.rows() << " x " << output_gradient.cols() << "; the outputs are "
          << workspace.samples_ << " x " << output_dim());
  Transpose(workspace);
  Grow(workspace.front_, kChunk, width_);
  Grow(workspace.back_, kChunk, width_);
  gradient.setZero(num_parameters());

  for (Eigen::Index first = 0; first < workspace.samples_; first += kChunk) {
    const int rows = static_cast<int>(std::min(kChunk, workspace.samples_ - first));
    const double* delta = output_gradient.data() + first * output_gradient.outerStride();
    std::ptrdiff_t delta_row = output_gradient.outerStride();
    double* next = workspace.front_.data();
    double* other = workspace.back_.data();
    for (std::size_t l = layers_.size(); l-- > 0;) {
      const Layer& layer = layers_[l];
      const bool bottom = l == 0;
      const double* const from = bottom
                                     ? inputs.data() + first * inputs.outerStride()
                                     : workspace.activations_[l - 1].data() + first * layer.inputs;
      Multiply({.m = layer.inputs,
                .n = layer.outputs,
                .k = rows,
                .a = from,
                .a_row = 1,
                .a_col = bottom ? inputs.outerStride() : layer.inputs,
                .b = delta,
                .b_row = delta_row,
                .c = gradient.data() + layer.weights,
                .c_row = layer.outputs,
                .accumulate = true});
      Multiply({.m = 1,
                .n = layer.outputs,
                .k = rows,
                .a = &kOne,
                .a_row = 0,
                .a_col = 0,
                .b = delta,
                .b_row = delta_row,
                .c = gradient.data() + layer.biases,
                .c_row = layer.outputs,
                .accumulate = true});
      if (bottom) break;
      Multiply({.m = rows,
                .n = layer.inputs,
                .k = layer.outputs,
                .a = delta,
                .a_row = delta_row,
                .a_col = 1,
                .b = workspace.transposed_.data() + layer.weights,
                .b_row = layer.inputs,
                .c = next,
                .c_row = layer.inputs});
      TimesTanhSlope(next, from, Entries(rows, layer.inputs));
      delta = next;
      delta_row = layer.inputs;
      std::swap(next, other);
    }
  }
}

// d(h_l) = (W_l' d(h_{l-1}) + dW_l' h_{l-1} + db_l) (1 - h_l^2), from d(h_0) = 0.
Eigen::Map<const core::Matrix> Mlp::Tangent(const Rows& inputs,
                                            const Eigen::Ref<const Eigen::VectorXd>& direction,
                                            Workspace& workspace) const {
  CheckAfterForward(inputs, workspace);
  DFR_THROW_UNLESS(direction.size() == num_parameters(),
                   "the direction has " << direction.size() << " entries, but the network has "
                                        << num_parameters() << " parameters");
  Grow(workspace.front_, kChunk, width_);
  Grow(workspace.back_, kChunk, width_);
  Grow(workspace.tangents_, workspace.samples_, output_dim());

  for (Eigen::Index first = 0; first < workspace.samples_; first += kChunk) {
    const int rows = static_cast<int>(std::min(kChunk, workspace.samples_ - first));
    const double* tangent = nullptr;
    double* next = workspace.front_.data();
    double* other = workspace.back_.data();
    for (std::size_t l = 0; l < layers_.size(); ++l) {
      const Layer& layer = layers_[l];
      const bool last = l + 1 == layers_.size();
      double* const to = last ? workspace.tangents_.data() + first * output_dim() : next;
      const double* const from = l == 0
                                     ? inputs.data() + first * inputs.outerStride()
                                     : workspace.activations_[l - 1].data() + first * layer.inputs;
      Multiply({.m = rows,
                .n = layer.outputs,
                .k = layer.inputs,
                .a = from,
                .a_row = l == 0 ? inputs.outerStride() : layer.inputs,
                .a_col = 1,
                .b = direction.data() + layer.weights,
                .b_row = layer.outputs,
                .c = to,
                .c_row = layer.outputs,
                .bias = direction.data() + layer.biases});
      if (tangent != nullptr) {
        Multiply({.m = rows,
                  .n = layer.outputs,
                  .k = layer.inputs,
                  .a = tangent,
                  .a_row = layer.inputs,
                  .a_col = 1,
                  .b = at(layer.weights),
                  .b_row = layer.outputs,
                  .c = to,
                  .c_row = layer.outputs,
                  .accumulate = true});
      }
      if (last) break;
      TimesTanhSlope(to, workspace.activations_[l].data() + first * layer.outputs,
                     Entries(rows, layer.outputs));
      tangent = next;
      std::swap(next, other);
    }
  }
  return {workspace.tangents_.data(), workspace.samples_, output_dim()};
}

void Mlp::Jacobian(const Rows& inputs, Workspace& workspace,
                   Eigen::Ref<core::Matrix> jacobian) const {
  CheckAfterForward(inputs, workspace);
  DFR_THROW_UNLESS(
      jacobian.rows() == workspace.samples_ * output_dim() && jacobian.cols() == num_parameters(),
      "the Jacobian is " << workspace.samples_ * output_dim() << " x " << num_parameters()
                         << ", not " << jacobian.rows() << " x " << jacobian.cols());
  std::array<double, kMaxWidth> buffers[2];
  for (Eigen::Index i = 0; i < workspace.samples_; ++i) {
    for (int o = 0; o < output_dim(); ++o) {
      double* const row = jacobian.data() + (i * output_dim() + o) * jacobian.outerStride();
      double* delta = buffers[0].data();
      double* next = buffers[1].data();
      std::fill_n(delta, output_dim(), 0.0);
      delta[o] = 1.0;
      for (std::size_t l = layers_.size(); l-- > 0;) {
        const Layer& layer = layers_[l];
        const double* const from = l == 0 ? inputs.data() + i * inputs.outerStride()
                                          : workspace.activations_[l - 1].data() + i * layer.inputs;
        for (int k = 0; k < layer.inputs; ++k) {
          double* const weights = row + layer.weights + Eigen::Index{k} * layer.outputs;
          for (int j = 0; j < layer.outputs; ++j) weights[j] = from[k] * delta[j];
        }
        std::copy_n(delta, layer.outputs, row + layer.biases);
        if (l == 0) break;
        for (int k = 0; k < layer.inputs; ++k) {
          const double* const weights = at(layer.weights) + Eigen::Index{k} * layer.outputs;
          double sum = 0.0;
          for (int j = 0; j < layer.outputs; ++j) sum += weights[j] * delta[j];
          next[k] = sum * (1.0 - from[k] * from[k]);
        }
        std::swap(delta, next);
      }
    }
  }
}

void Mlp::Save(core::ArchiveWriter& archive) const {
  archive.Integers(sizes_);
  archive.Numbers(core::AsSpan(parameters_));
}

Mlp Mlp::Load(core::ArchiveReader& archive) {
  const std::vector<int> sizes = archive.Integers();
  const std::vector<double> parameters = archive.Numbers();
  internal::SpendWeights(sizes, archive);
  try {
    Mlp mlp(sizes);
    mlp.SetParameters(core::AsVector(parameters));
    return mlp;
  } catch (const std::invalid_argument& e) {
    archive.Fail(e.what());
  }
}

}  // namespace dfr::imitation
