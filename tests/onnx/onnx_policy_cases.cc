// Writes exported policies with random states, for onnx_peer.cjs. usage: onnx_policy_cases DIR
#include <filesystem>
#include <string>
#include <vector>

#include "dfr/core/files/onnx_graph.h"
#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "dfr/imitation/mlp_policy.h"
#include "dfr/imitation/onnx_export.h"
#include "dfr/kernel/one_class_svm.h"
#include "dfr/kernel/onnx_export.h"
#include "tests/onnx/case.h"

namespace dfr::test {
namespace {

imitation::MlpPolicy MakePolicy(core::Random& random) {
  core::StateLayout layout;
  layout.Add("object", 3);
  layout.Add("ignored", 2);
  layout.Add("tip", 2);
  return {layout, "tip,object[0:2]",
          imitation::Whitening(Eigen::Vector4d(1.0, -2.0, 0.5, 30.0),
                               Eigen::Vector4d(0.1, 3.0, 1.0, 7.0)),
          imitation::Mlp({4, 64, 64, 2}, random), Eigen::Vector2d(1.0, 0.25)};
}

void WritePolicy(const std::filesystem::path& folder) {
  core::Random random(3);
  const auto policy = MakePolicy(random);
  const Matrix x = 3.0 * Normal(200, 7, random);
  Matrix u(200, 2);
  for (Eigen::Index i = 0; i < 200; ++i) policy.Control(0, core::Row(x, i), core::Row(u, i));
  Case c{folder, "mlp_policy", {}};
  imitation::ExportOnnx(policy, c.model());
  c.Add("x", x);
  c.Write("u", "[200,2]", {u.data(), u.data() + u.size()});
}

// Writes one file with a policy and a support that evaluates the policy's control.
void WriteBoth(const std::filesystem::path& folder) {
  core::Random random(4);
  const auto policy = MakePolicy(random);
  const auto svm = kernel::OneClassSvm::Fit(0.3 * Normal(50, 2, random), {.nu = 0.2, .gamma = 1.0});
  const Matrix x = Normal(200, 7, random);
  std::vector<double> g;
  for (Eigen::Index i = 0; i < 200; ++i) {
    double u[2];
    policy.Control(0, core::Row(x, i), u);
    g.push_back(svm.Decision(u));
  }
  Case c{folder, "policy_and_support", {}};
  core::OnnxGraph graph("both");
  const std::string state = graph.Input("x", core::OnnxGraph::Type::kDouble, {-1, 7});
  const std::string u = imitation::AppendControl(graph, policy, state);
  graph.Output(kernel::AppendDecision(graph, svm, u), "g", core::OnnxGraph::Type::kDouble, {-1});
  graph.Save(c.model());
  c.Add("x", x);
  c.Write("g", "[200]", g);
}
}  // namespace
}  // namespace dfr::test

int main(int argc, char** argv) {
  return dfr::test::WriteCases(argc, argv, [](const auto& folder) {
    dfr::test::WritePolicy(folder);
    dfr::test::WriteBoth(folder);
  });
}
