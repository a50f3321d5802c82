// Writes exported supports with random states, for onnx_peer.cjs. usage: onnx_support_cases DIR
#include <filesystem>
#include <string>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "dfr/kernel/one_class_svm.h"
#include "dfr/kernel/onnx_export.h"
#include "dfr/kernel/time_varying_support.h"
#include "tests/onnx/case.h"

namespace dfr::test {
namespace {

void WriteSvm(const std::filesystem::path& folder, const std::string& name, double gamma) {
  core::Random random(1);
  const auto svm = kernel::OneClassSvm::Fit(Normal(300, 9, random), {.nu = 0.1, .gamma = gamma});
  const Matrix x = 1.5 * Normal(200, 9, random);
  std::vector<double> g(200);
  svm.DecisionBatch(x, g);
  Case c{folder, name, {}};
  kernel::ExportOnnx(svm, c.model());
  c.Add("x", x);
  c.Write("g", "[200]", g);
}

kernel::TimeVaryingSupport FitSupport(core::Random& random) {
  std::vector<Matrix> demonstrations;
  for (int i = 0; i < 20; ++i) {
    demonstrations.push_back(Normal(8 + i % 5, 4, random));
    for (Eigen::Index t = 0; t < demonstrations.back().rows(); ++t) {
      demonstrations.back().row(t).array() += 0.3 * static_cast<double>(t);
    }
  }
  return kernel::TimeVaryingSupport::Fit(demonstrations, {.svm = {.nu = 0.2, .gamma = 0.3}});
}

void WriteSupport(const std::filesystem::path& folder) {
  core::Random random(2);
  const auto support = FitSupport(random);
  const Matrix x = 2.0 * Normal(200, 4, random);
  std::vector<int> t;
  std::vector<double> g;
  for (int i = 0; i < 200; ++i) {
    t.push_back(static_cast<int>(random.Below(20)) -
                4);  // includes steps before the first and after the last
    g.push_back(support.Decision(t.back(), core::Row(x, i)));
  }
  Case c{folder, "time_varying_support", {}};
  kernel::ExportOnnx(support, c.model());
  c.Add("t", t);
  c.Add("x", x);
  c.Write("g", "[200]", g);
}
}  // namespace
}  // namespace dfr::test

int main(int argc, char** argv) {
  return dfr::test::WriteCases(argc, argv, [](const auto& folder) {
    dfr::test::WriteSvm(folder, "wide_svm", 1.0 / 9.0);
    dfr::test::WriteSvm(folder, "narrow_svm", 5.0);
    dfr::test::WriteSupport(folder);
  });
}
