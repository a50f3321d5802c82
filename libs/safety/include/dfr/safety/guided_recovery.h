#pragma once

#include <memory>
#include <span>

#include "dfr/control/guided/guided_model.h"
#include "dfr/core/archive.h"
#include "dfr/core/features.h"
#include "dfr/core/trajectory.h"
#include "dfr/kernel/whitened_support.h"

namespace dfr::safety {

/// What guided recovery learns from demonstrations of one task (docs/recovery.md): whitened
/// features, their support at each time step, the levels that demonstrations keep, the slack that
/// unseen ones need, and how features answered controls. The order of the demonstrations changes no
/// bit of it.
///
/// Immutable; controllers share it. Its parts borrow from each other, so it stays where it was
/// made.
class GuidedRecovery {
 public:
  /// Fits to demonstrations of whole states, of which the support looks at `features`.
  /// @throws std::invalid_argument if there are fewer than three demonstrations, they do not fit
  ///   each other or the features, no feature differs between them, or no control differs from
  ///   zero.
  GuidedRecovery(const core::FeatureSelection& features,
                 std::span<const core::Trajectory> demonstrations,
                 const kernel::WhitenedSupportOptions& options = {},
                 const core::WhiteningOptions& whitening = {});
  /// The same with features of the caller's own.
  GuidedRecovery(core::FeatureTransform features, std::span<const core::Trajectory> demonstrations,
                 const kernel::WhitenedSupportOptions& options = {});
  /// The same where `support` is what WhitenedSupport::Fit() makes of these features, in
  /// core::ContentOrder() of the demonstrations, with these options.
  GuidedRecovery(core::FeatureTransform features, std::span<const core::Trajectory> demonstrations,
                 kernel::WhitenedSupport support, const kernel::WhitenedSupportOptions& options);
  GuidedRecovery(const GuidedRecovery&) = delete;
  GuidedRecovery& operator=(const GuidedRecovery&) = delete;

  /// Appends all of it to a file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote; `selection` is the one that it was fitted with.
  /// @throws std::runtime_error naming the file and what is wrong with it.
  static std::unique_ptr<const GuidedRecovery> Load(core::ArchiveReader& archive,
                                                    core::FeatureSelection selection);

  /// z of a whole state.
  [[nodiscard]] const core::FeatureTransform& features() const noexcept {
    return model_.features();
  }
  /// g_t of z.
  [[nodiscard]] const kernel::WhitenedSupport& support() const noexcept { return support_; }
  /// For control::GuidedPolicy.
  [[nodiscard]] const control::GuidedModel& model() const noexcept { return model_; }
  /// kernel::WhitenedSupportOptions::single_precision
  [[nodiscard]] bool single_precision() const noexcept { return single_precision_; }

 private:
  struct Prepared;
  GuidedRecovery(Prepared prepared, const kernel::WhitenedSupportOptions& options);
  GuidedRecovery(Prepared&& prepared, kernel::WhitenedSupport support,
                 const kernel::WhitenedSupportOptions& options);
  struct Loaded;
  GuidedRecovery(Loaded loaded, core::ArchiveReader& archive);

  bool single_precision_;
  kernel::WhitenedSupport support_;
  control::GuidedModel model_;  // borrows support_
};

}  // namespace dfr::safety
