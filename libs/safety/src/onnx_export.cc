#include "dfr/safety/onnx_export.h"

#include <cstdint>
#include <vector>

#include "dfr/core/feature_transform.h"
#include "dfr/core/matrix.h"
#include "dfr/kernel/onnx_export.h"

namespace dfr::safety {

using core::OnnxGraph;

std::string AppendDecision(OnnxGraph& graph, const GuardModel& model, const std::string& t,
                           const std::string& x) {
  const core::FeatureTransform& features = model.recovery().features();
  const std::vector<int>& chosen = features.selection().indices();
  const std::vector<std::int64_t> indices(chosen.begin(), chosen.end());
  const std::int64_t count[] = {static_cast<std::int64_t>(indices.size())};
  const std::string selected =
      graph.Node("Gather", {x, graph.Constant(indices, count)}, {{"axis", 1}});
  const std::string centred =
      graph.Node("Sub", {selected, graph.Vector(core::AsSpan(features.offset()))});
  const std::string z =
      graph.Node("MatMul", {centred, graph.Matrix2d(features.scale().transpose())});
  return kernel::AppendDecision(graph, model.recovery().support(), t, z);
}

void ExportOnnx(const GuardModel& model, const std::filesystem::path& path) {
  OnnxGraph graph("guard");
  const std::string t = graph.Input("t", OnnxGraph::Type::kInt64, {-1});
  const std::string x = graph.Input("x", OnnxGraph::Type::kDouble, {-1, model.state_dim()});
  graph.Output(AppendDecision(graph, model, t, x), "g", OnnxGraph::Type::kDouble, {-1});
  graph.Save(path);
}

}  // namespace dfr::safety
