#include "dfr/safety/onnx_export.h"

#include <cstdint>
#include <stdexcept>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/features/absolute_actions.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/core/features/rotations.h"
#include "dfr/core/matrix.h"
#include "dfr/kernel/onnx_export.h"

namespace dfr::safety {

using core::OnnxGraph;

void CheckExport(const GuardModel& model) {
  DFR_THROW_UNLESS(model.reduction() == nullptr,
                   "a guard with reduced features, "
                       << model.task().features().selection().spec()
                       << ", cannot be exported: the formats have no reduction. Fit a guard "
                          "without pca:, points: and slow:");
  const core::StateMap& map = model.task().features().selection().map();
  if (!map.quaternions().empty()) {
    const int first = map.quaternions()[0].first;
    throw std::invalid_argument(
        "cannot export a guard that uses the quaternion " +
        core::EntryRange(model.layout(), first, 4) +
        ", whose sign is not a linear function: fit a guard to two columns of the "
        "rotation matrix instead");
  }
  if (!map.angles().empty() || !map.circles().empty()) {
    const int entry = map.angles().empty() ? map.circles()[0].entry : map.angles()[0].entry;
    throw std::invalid_argument("cannot export a guard that uses the angle " +
                                core::EntryName(model.layout(), entry) +
                                ", which jumps: fit a guard to its cosine and sine instead");
  }
}

std::string AppendDecision(OnnxGraph& graph, const GuardModel& model, const std::string& t,
                           const std::string& x) {
  const core::FeatureTransform& features = model.task().features();
  CheckExport(model);
  const std::vector<int>& chosen = features.selection().indices();
  const std::vector<std::int64_t> indices(chosen.begin(), chosen.end());
  const std::int64_t count[] = {static_cast<std::int64_t>(indices.size())};
  const std::string selected =
      graph.Node("Gather", {x, graph.Constant(indices, count)}, {{"axis", 1}});
  const std::string centred =
      graph.Node("Sub", {selected, graph.Vector(core::AsSpan(features.offset()))});
  const std::string z =
      graph.Node("MatMul", {centred, graph.Matrix2d(features.scale().transpose())});
  return kernel::AppendDecision(graph, model.task().feature_support(), t, z);
}

void ExportOnnx(const GuardModel& model, const std::filesystem::path& path) {
  OnnxGraph graph("guard");
  const std::string t = graph.Input("t", OnnxGraph::Type::kInt64, {-1});
  const std::string x = graph.Input("x", OnnxGraph::Type::kDouble, {-1, model.state_dim()});
  graph.Output(AppendDecision(graph, model, t, x), "g", OnnxGraph::Type::kDouble, {-1});
  graph.Save(path);
}

}  // namespace dfr::safety
