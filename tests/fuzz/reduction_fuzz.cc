// Reductions with a valid checksum around arbitrary values: every reduction that loads can be
// applied.
#include <stdexcept>
#include <vector>

#include "dfr/core/files/archive.h"
#include "dfr/reduction/reduction.h"
#include "dfr/reduction/state_reduction.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

namespace {

using dfr::reduction::Reduction;
using dfr::reduction::StateReduction;

void TryReduction(const std::filesystem::path& path) {
  dfr::core::ArchiveReader archive(path, "reduction", 1);
  const Reduction reduction = Reduction::Load(archive);
  archive.End();
  std::vector<double> x(static_cast<std::size_t>(reduction.input_dim()), 0.5);
  std::vector<double> z(static_cast<std::size_t>(reduction.num_components()));
  reduction.Apply(x, z);
}

// Reads a reduction of states with two pictures and another block, and applies it.
void TryStateReduction(const std::filesystem::path& path) {
  dfr::core::StateLayout layout;
  layout.Add("a", dfr::core::PictureShape{7, 6, 1});
  layout.Add("b", dfr::core::PictureShape{8, 8, 3});
  layout.Add("c", 3);
  dfr::core::ArchiveReader archive(path, "reduction", 1);
  const StateReduction reduction = StateReduction::Load(archive, layout);
  std::vector<double> state(static_cast<std::size_t>(reduction.state_dim()));
  for (std::size_t i = 0; i < state.size(); ++i) state[i] = static_cast<double>(i * 37 % 200);
  StateReduction::Workspace workspace(reduction);
  static_cast<void>(reduction.Apply(state, workspace));
  std::vector<double> shares(state.size());
  reduction.Spread(Eigen::MatrixXd::Ones(reduction.reduced_dim(), reduction.reduced_dim()), state,
                   shares);
}

}  // namespace

DFR_FUZZ_TARGET(reduction) {
  const std::filesystem::path path =
      dfr::fuzz::InputFile(dfr::fuzz::Archive("reduction", 1, dfr::fuzz::AsText(data, size)));
  for (const auto attempt : {TryReduction, TryStateReduction}) {
    try {
      attempt(path);
    } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): expected for bad input
    }
  }
  return 0;
}
