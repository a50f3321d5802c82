#include "dfr/imitation/onnx_export.h"

#include <cstdint>
#include <span>
#include <vector>

namespace dfr::imitation {

using core::OnnxGraph;
using Type = OnnxGraph::Type;

std::string AppendControl(OnnxGraph& graph, const MlpPolicy& policy, const std::string& x) {
  const std::vector<int>& chosen = policy.selection().indices();
  const std::vector<std::int64_t> indices(chosen.begin(), chosen.end());
  const auto count = static_cast<std::int64_t>(indices.size());
  const std::string features =
      graph.Node("Gather", {x, graph.Constant(indices, std::span(&count, 1))}, {{"axis", 1}});
  const Whitening& whitening = policy.whitening();
  const std::string centred =
      graph.Node("Sub", {features, graph.Vector(core::AsSpan(whitening.mean()))});
  std::string h = graph.Node("Div", {centred, graph.Vector(core::AsSpan(whitening.scale()))});

  const Mlp& mlp = policy.mlp();
  const std::span<const double> parameters = core::AsSpan(mlp.parameters());
  for (std::size_t l = 0; l < mlp.layers().size(); ++l) {
    const Mlp::Layer& layer = mlp.layers()[l];
    const auto inputs = static_cast<std::size_t>(layer.inputs);
    const auto outputs = static_cast<std::size_t>(layer.outputs);
    const std::int64_t shape[] = {layer.inputs, layer.outputs};
    const std::string weights = graph.Constant(
        parameters.subspan(static_cast<std::size_t>(layer.weights), inputs * outputs), shape);
    const std::string biases =
        graph.Vector(parameters.subspan(static_cast<std::size_t>(layer.biases), outputs));
    h = graph.Node("Gemm", {h, weights, biases});
    if (l + 1 < mlp.layers().size()) h = graph.Node("Tanh", {h});
  }
  const Eigen::VectorXd low = -policy.control_limit();
  const std::string above = graph.Node("Max", {h, graph.Vector(core::AsSpan(low))});
  return graph.Node("Min", {above, graph.Vector(core::AsSpan(policy.control_limit()))});
}

void ExportOnnx(const MlpPolicy& policy, const std::filesystem::path& path) {
  OnnxGraph graph("mlp_policy");
  const std::string x = graph.Input("x", Type::kDouble, {-1, policy.state_dim()});
  graph.Output(AppendControl(graph, policy, x), "u", Type::kDouble, {-1, policy.control_dim()});
  graph.Save(path);
}

}  // namespace dfr::imitation
