#include <cstdio>
#include <sstream>
#include <stdexcept>
#include <string>
#include <system_error>

#include "commands.h"
#include "dfr/core/files/atomic_file.h"
#include "dfr/core/files/output_path.h"
#include "dfr/core/text/format.h"
#include "dfr/kernel/libsvm_io.h"
#include "dfr/safety/onnx_export.h"

namespace dfr::apps::guard {
namespace {

void WriteMatrix(std::ostream& out, const core::Matrix& values) {
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
    std::ostringstream map;
    map.precision(17);
    WriteMatrix(map, support.map(t) * features.scale());
    core::ReplaceFile(folder / (name + ".csv"), map.view());
  }
  std::ostringstream out;
  out.precision(17);
  out << "entry of the state,offset\n";
  for (int k = 0; k < features.selection().num_features(); ++k) {
    out << features.selection().indices()[static_cast<std::size_t>(k)] << ','
        << features.offset()[k] << '\n';
  }
  core::ReplaceFile(folder / "features.csv", out.view());
}

}  // namespace

std::string UnusableExportFolder(const std::filesystem::path& folder) {
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
    const std::string name = entry.path().filename().string();
    const std::string stem = entry.path().stem().string();
    const std::string ending = entry.path().extension().string();
    const bool step = (ending == ".model" || ending == ".csv") && stem.starts_with("t_") &&
                      stem.size() > 2 &&
                      stem.find_first_not_of("0123456789", 2) == std::string::npos;
    if (step || name == "features.csv") {
      return folder.string() + ": has " + name +
             " of an earlier export, which would mix with this one; remove the folder or name "
             "another";
    }
  }
  return core::UnwritableFolder(folder);
}

void RunExport(const ExportOptions& options) {
  const auto model = LoadGuard(options.guard);
  if (!options.onnx.empty()) {
    safety::ExportOnnx(*model, options.onnx);
    Print("%s: t (rows), x (rows x %d) -> g (rows)\n", options.onnx.c_str(), model->state_dim());
  }
  if (!options.libsvm.empty()) {
    ExportLibsvm(*model, options.libsvm);
    Print(
        "%s: %d models; row y of t_<t>.csv times (entries of features.csv less their "
        "offsets) is feature y\n",
        options.libsvm.c_str(), model->num_steps());
  }
}

}  // namespace dfr::apps::guard
