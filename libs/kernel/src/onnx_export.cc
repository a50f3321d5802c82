#include "dfr/kernel/onnx_export.h"

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

namespace dfr::kernel {
namespace {

using core::OnnxGraph;
using Type = OnnxGraph::Type;

// Appends |x - s|^2 (rows x S) for states x (rows x n) and support vectors s (S x n, or rows x S x
// n). Sums squared differences, as the library does, because |x|^2 + |s|^2 - 2 x's would cancel.
std::string SquaredDistances(OnnxGraph& graph, const std::string& x, const std::string& vectors) {
  const std::string column = graph.Node("Unsqueeze", {x, graph.Integers({1})});
  const std::string difference = graph.Node("Sub", {column, vectors});
  const std::string squared = graph.Node("Mul", {difference, difference});
  return graph.Node("ReduceSum", {squared, graph.Integers({2})}, {{"keepdims", 0}});
}

// Returns t, or the nearest time step with an estimate.
std::string ClippedStep(OnnxGraph& graph, const std::string& t, std::int64_t steps) {
  const std::int64_t first = 0;
  const std::int64_t last = steps - 1;
  return graph.Node("Clip", {t, graph.Constant(std::span(&first, 1), {}),
                             graph.Constant(std::span(&last, 1), {})});
}

}  // namespace

std::string AppendDecision(OnnxGraph& graph, const OneClassSvm& svm, const std::string& x) {
  const std::string squared = SquaredDistances(graph, x, graph.Matrix2d(svm.support_vectors()));
  const std::string exponent = graph.Node("Mul", {squared, graph.Constant(-svm.gamma())});
  const std::string kernel = graph.Node("Exp", {exponent});
  const std::string sum = graph.Node("MatMul", {kernel, graph.Vector(core::AsSpan(svm.alpha()))});
  return graph.Node("Sub", {sum, graph.Constant(svm.rho())});
}

std::string AppendDecision(OnnxGraph& graph, const TimeVaryingSupport& support,
                           const std::string& t, const std::string& x) {
  const std::int64_t steps = support.num_steps();
  const std::int64_t dim = support.state_dim();
  std::int64_t most = 0;
  for (int i = 0; i < steps; ++i) {
    most = std::max<std::int64_t>(most, support.at(i).num_support_vectors());
  }
  // Padding has alpha = 0.
  std::vector<double> vectors(static_cast<std::size_t>(steps * most * dim), 0.0);
  std::vector<double> alpha(static_cast<std::size_t>(steps * most), 0.0);
  std::vector<double> gamma;
  std::vector<double> rho;
  for (int i = 0; i < steps; ++i) {
    const OneClassSvm& svm = support.at(i);
    std::copy_n(svm.support_vectors().data(), svm.support_vectors().size(),
                vectors.begin() + i * most * dim);
    std::copy_n(svm.alpha().data(), svm.alpha().size(), alpha.begin() + i * most);
    gamma.push_back(-svm.gamma());
    rho.push_back(svm.rho());
  }
  const std::int64_t vectors_shape[] = {steps, most, dim};
  const std::int64_t alpha_shape[] = {steps, most};
  const std::int64_t gamma_shape[] = {steps, 1};

  const std::string step = ClippedStep(graph, t, steps);
  const auto at_step = [&](const std::string& values) {
    return graph.Node("Gather", {values, step}, {{"axis", 0}});
  };
  const std::string squared =
      SquaredDistances(graph, x, at_step(graph.Constant(vectors, vectors_shape)));
  const std::string exponent =
      graph.Node("Mul", {squared, at_step(graph.Constant(gamma, gamma_shape))});
  const std::string kernel = graph.Node("Exp", {exponent});
  const std::string weighted =
      graph.Node("Mul", {kernel, at_step(graph.Constant(alpha, alpha_shape))});
  const std::string sum =
      graph.Node("ReduceSum", {weighted, graph.Integers({1})}, {{"keepdims", 0}});
  return graph.Node("Sub", {sum, at_step(graph.Vector(rho))});
}

std::string AppendDecision(OnnxGraph& graph, const WhitenedSupport& support, const std::string& t,
                           const std::string& z) {
  const std::int64_t steps = support.num_steps();
  const std::int64_t dim = support.state_dim();
  std::vector<double> maps;
  std::vector<OneClassSvm> estimates;
  for (int i = 0; i < steps; ++i) {
    const core::Matrix& map = support.map(i);
    maps.insert(maps.end(), map.data(), map.data() + map.size());
    estimates.push_back(support.estimate(i));
  }
  const std::int64_t shape[] = {steps, dim, dim};
  const std::string at_step = graph.Node(
      "Gather", {graph.Constant(maps, shape), ClippedStep(graph, t, steps)}, {{"axis", 0}});
  // y = map z, row by row: (rows x dim x dim) times (rows x dim x 1).
  const std::string column = graph.Node("Unsqueeze", {z, graph.Integers({2})});
  const std::string product = graph.Node("MatMul", {at_step, column});
  const std::string y = graph.Node("Squeeze", {product, graph.Integers({2})});
  return AppendDecision(graph, TimeVaryingSupport(std::move(estimates)), t, y);
}

void ExportOnnx(const OneClassSvm& svm, const std::filesystem::path& path) {
  OnnxGraph graph("one_class_svm");
  const std::string x = graph.Input("x", Type::kDouble, {-1, svm.state_dim()});
  graph.Output(AppendDecision(graph, svm, x), "g", Type::kDouble, {-1});
  graph.Save(path);
}

void ExportOnnx(const TimeVaryingSupport& support, const std::filesystem::path& path) {
  OnnxGraph graph("time_varying_support");
  const std::string t = graph.Input("t", Type::kInt64, {-1});
  const std::string x = graph.Input("x", Type::kDouble, {-1, support.state_dim()});
  graph.Output(AppendDecision(graph, support, t, x), "g", Type::kDouble, {-1});
  graph.Save(path);
}

}  // namespace dfr::kernel
