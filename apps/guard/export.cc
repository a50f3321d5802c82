#include <cstdio>
#include <fstream>
#include <stdexcept>
#include <string>
#include <system_error>

#include "commands.h"
#include "dfr/core/text/format.h"
#include "dfr/kernel/libsvm_io.h"
#include "dfr/safety/onnx_export.h"

namespace dfr::apps::guard {
namespace {

void WriteMatrix(std::ofstream& out, const core::Matrix& values) {
  for (Eigen::Index i = 0; i < values.rows(); ++i) {
    for (Eigen::Index k = 0; k < values.cols(); ++k) out << (k == 0 ? "" : ",") << values(i, k);
    out << '\n';
  }
}

// Writes a model of the whitened features y per time step (t_000.model, ...), and the map from a
// state to y (features.csv, t_000.csv, ...).
void ExportLibsvm(const safety::GuardModel& model, const std::filesystem::path& folder) {
  safety::CheckExport(model);
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) {
    throw std::runtime_error(folder.string() + ": cannot be created: " + error.message());
  }
  const core::FeatureTransform& features = model.task().features();
  const kernel::WhitenedSupport& support = model.task().feature_support();
  for (int t = 0; t < model.num_steps(); ++t) {
    const std::string name = core::Format("t_%03d", t);
    kernel::SaveLibsvmModel(support.estimate(t), folder / (name + ".model"));
    // y = V_t W (f(x) - offset)
    std::ofstream map(folder / (name + ".csv"));
    map.precision(17);
    WriteMatrix(map, support.map(t) * features.scale());
    map.flush();
    if (!map) throw std::runtime_error(folder.string() + ": cannot be written");
  }
  std::ofstream out(folder / "features.csv");
  out.precision(17);
  out << "entry of the state,offset\n";
  for (int k = 0; k < features.selection().num_features(); ++k) {
    out << features.selection().indices()[static_cast<std::size_t>(k)] << ','
        << features.offset()[k] << '\n';
  }
  out.flush();
  if (!out) throw std::runtime_error(folder.string() + ": cannot be written");
}

}  // namespace

void RunExport(const ExportOptions& options) {
  if (options.onnx.empty() && options.libsvm.empty()) {
    throw std::runtime_error("export needs --onnx FILE or --libsvm FOLDER");
  }
  const auto model = safety::GuardModel::Load(options.guard);
  if (!options.onnx.empty()) {
    safety::ExportOnnx(*model, options.onnx);
    std::printf("%s: t (rows), x (rows x %d) -> g (rows)\n", options.onnx.c_str(),
                model->state_dim());
  }
  if (!options.libsvm.empty()) {
    ExportLibsvm(*model, options.libsvm);
    std::printf(
        "%s: %d models; row y of t_<t>.csv times (entries of features.csv less their "
        "offsets) is feature y\n",
        options.libsvm.c_str(), model->num_steps());
  }
}

}  // namespace dfr::apps::guard
