#include "dfr/safety/guided_recovery.h"

#include <stdexcept>
#include <utility>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/feature_transform.h"
#include "dfr/core/folds.h"
#include "dfr/kernel/one_class_svm.h"

namespace dfr::safety {
namespace {

// More time steps than any task has, and few enough that a damaged count is noticed.
constexpr int kMostSteps = 1'000'000;

core::FeatureTransform Whitened(const core::FeatureSelection& selection,
                                std::span<const core::Trajectory> demonstrations,
                                const core::WhiteningOptions& options) {
  std::vector<core::Matrix> states;
  states.reserve(demonstrations.size());
  for (const std::size_t d : core::ContentOrder(demonstrations)) {
    states.push_back(demonstrations[d].states);
  }
  return core::FeatureTransform::Whitening(selection, states, options);
}

std::vector<core::Matrix> Points(std::span<const core::Trajectory> demonstrations,
                                 const core::FeatureTransform& features) {
  std::vector<core::Matrix> points;
  points.reserve(demonstrations.size());
  for (const core::Trajectory& trajectory : demonstrations) {
    points.push_back(features.Apply(trajectory.states));
  }
  return points;
}

kernel::WhitenedSupport LoadSupport(core::ArchiveReader& archive, bool single_precision) {
  const int steps = archive.IntegerIn(1, kMostSteps);
  std::vector<kernel::WhitenedSupport::Estimate> estimates;
  for (int t = 0; t < steps; ++t) {
    core::Matrix map = archive.MatrixBlock();
    const double gamma = archive.Number();
    const double rho = archive.Number();
    const double scale = archive.Number();
    const std::vector<double> alpha = archive.Numbers();
    auto svm = kernel::OneClassSvm::FromParts(archive.MatrixBlock(), core::AsVector(alpha), gamma,
                                              rho, scale);
    estimates.push_back({std::move(map), single_precision ? svm.InSinglePrecision() : svm});
  }
  return kernel::WhitenedSupport(std::move(estimates));
}

}  // namespace

struct GuidedRecovery::Prepared {
  Prepared(core::FeatureTransform transform, std::span<const core::Trajectory> recorded)
      : features(std::move(transform)),
        demonstrations(core::InContentOrder(recorded)),
        points(Points(demonstrations, features)) {}
  core::FeatureTransform features;
  std::vector<core::Trajectory> demonstrations;
  std::vector<core::Matrix> points;
};

struct GuidedRecovery::Loaded {
  core::FeatureTransform features;
  bool single_precision;
  kernel::WhitenedSupport support;
};

GuidedRecovery::GuidedRecovery(const core::FeatureSelection& features,
                               std::span<const core::Trajectory> demonstrations,
                               const kernel::WhitenedSupportOptions& options,
                               const core::WhiteningOptions& whitening)
    : GuidedRecovery(Whitened(features, demonstrations, whitening), demonstrations, options) {}

GuidedRecovery::GuidedRecovery(core::FeatureTransform features,
                               std::span<const core::Trajectory> demonstrations,
                               const kernel::WhitenedSupportOptions& options)
    : GuidedRecovery(Prepared(std::move(features), demonstrations), options) {}

GuidedRecovery::GuidedRecovery(core::FeatureTransform features,
                               std::span<const core::Trajectory> demonstrations,
                               kernel::WhitenedSupport support,
                               const kernel::WhitenedSupportOptions& options)
    : GuidedRecovery(Prepared(std::move(features), demonstrations), std::move(support), options) {}

GuidedRecovery::GuidedRecovery(Prepared prepared, const kernel::WhitenedSupportOptions& options)
    : GuidedRecovery(std::move(prepared), kernel::WhitenedSupport::Fit(prepared.points, options),
                     options) {}

GuidedRecovery::GuidedRecovery(Prepared&& prepared, kernel::WhitenedSupport support,
                               const kernel::WhitenedSupportOptions& options)
    : single_precision_(options.single_precision),
      support_(std::move(support)),
      model_(std::move(prepared.features), support_, prepared.demonstrations,
             {.slack = control::SlackFrom(kernel::HeldOutLevels(prepared.points, options))}) {}

GuidedRecovery::GuidedRecovery(Loaded loaded, core::ArchiveReader& archive)
    : single_precision_(loaded.single_precision),
      support_(std::move(loaded.support)),
      model_(control::GuidedModel::Load(archive, std::move(loaded.features), support_)) {}

void GuidedRecovery::Save(core::ArchiveWriter& archive) const {
  archive.Numbers(core::AsSpan(features().offset()));
  archive.MatrixBlock(features().scale());
  archive.Integer(single_precision_ ? 1 : 0);
  archive.Integer(support_.num_steps());
  for (int t = 0; t < support_.num_steps(); ++t) {
    const kernel::OneClassSvm& svm = support_.estimate(t);
    archive.MatrixBlock(support_.map(t));
    archive.Number(svm.gamma());
    archive.Number(svm.rho());
    archive.Number(svm.libsvm_scale());
    archive.Numbers(core::AsSpan(svm.alpha()));
    archive.MatrixBlock(svm.support_vectors());
  }
  model_.Save(archive);
}

std::unique_ptr<const GuidedRecovery> GuidedRecovery::Load(core::ArchiveReader& archive,
                                                           core::FeatureSelection selection) {
  try {
    const std::vector<double> offset = archive.Numbers();
    core::FeatureTransform features(std::move(selection), core::AsVector(offset),
                                    archive.MatrixBlock());
    const bool single_precision = archive.IntegerIn(0, 1) == 1;
    kernel::WhitenedSupport support = LoadSupport(archive, single_precision);
    DFR_THROW_UNLESS(support.state_dim() == features.num_features(),
                     "the support is one of " << support.state_dim() << " features, there are "
                                              << features.num_features());
    return std::unique_ptr<const GuidedRecovery>(new GuidedRecovery(
        Loaded{std::move(features), single_precision, std::move(support)}, archive));
  } catch (const std::invalid_argument& e) {
    archive.Fail(e.what());
  }
}

}  // namespace dfr::safety
