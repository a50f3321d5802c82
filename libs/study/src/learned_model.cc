#include "dfr/study/learned_model.h"

#include <utility>

#include "dfr/core/contract.h"

namespace dfr::study {

LearnedModel::LearnedModel(imitation::MlpPolicy policy, FittedTask fit,
                           imitation::DemonstrationSet set, Expert teaching)
    : parts_(std::make_unique<const Parts>(std::move(policy), std::move(fit), std::move(set),
                                           std::move(teaching))) {}

void LearnedModel::Save(const std::filesystem::path& folder) const {
  DFR_THROW_UNLESS(fit().guard() == nullptr, "a guard's model has a separate file: save the guard");
  task().Save(folder);
  policy().Save(folder / "policy.dfr");
  imitation::SaveRobomimic(demonstrations(), folder / "demonstrations.hdf5");
}

LearnedModel LearnedModel::Load(const std::filesystem::path& folder) {
  imitation::MlpPolicy policy = imitation::MlpPolicy::Load(folder / "policy.dfr");
  imitation::DemonstrationSet set = imitation::LoadRobomimic(folder / "demonstrations.hdf5");
  safety::TaskModel task = safety::TaskModel::Load(folder, policy.layout());
  return {std::move(policy), std::move(task), std::move(set)};
}

}  // namespace dfr::study
