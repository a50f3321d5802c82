// Writes an exported guard with random states, for onnx_peer.cjs. usage: onnx_guard_cases DIR
#include <filesystem>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "dfr/safety/guard_model.h"
#include "dfr/safety/onnx_export.h"
#include "tests/onnx/case.h"

namespace dfr::test {
namespace {

// Fits a guard to states of seven entries, of which four are features in another order.
std::shared_ptr<const safety::GuardModel> FitGuard(core::Random& random) {
  core::StateLayout layout;
  layout.Add("object", 3);
  layout.Add("clock", 1);
  layout.Add("tip", 3);
  std::vector<core::Trajectory> demonstrations(25);
  for (auto& demonstration : demonstrations) {
    demonstration.states = 0.2 * Normal(16, 7, random);
    demonstration.controls = Normal(15, 2, random);
    for (Eigen::Index t = 0; t < 16; ++t) {
      demonstration.states.row(t).array() += 0.3 * static_cast<double>(t);
    }
  }
  return safety::GuardModel::Fit(layout, demonstrations, {.features = "tip[0:2],object[1:3]"});
}

void WriteGuard(const std::filesystem::path& folder) {
  core::Random random(3);
  const auto model = FitGuard(random);
  Matrix x = 0.4 * Normal(300, 7, random);
  std::vector<int> t;
  std::vector<double> g;
  for (int i = 0; i < 300; ++i) {
    // Includes steps before the first and after the last time step.
    t.push_back(static_cast<int>(random.Below(24)) - 4);
    x.row(i).array() += 0.3 * static_cast<double>(t.back());
    g.push_back(model->support().Decision(t.back(), core::Row(x, i)));
  }
  Case c{folder, "guard", {}};
  safety::ExportOnnx(*model, c.model());
  c.Add("t", t);
  c.Add("x", x);
  c.Write("g", "[300]", g);
}

}  // namespace
}  // namespace dfr::test

int main(int argc, char** argv) {
  return dfr::test::WriteCases(argc, argv,
                               [](const auto& folder) { dfr::test::WriteGuard(folder); });
}
