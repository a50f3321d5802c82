#pragma once

#include <span>

#include "apps/planar/task.h"
#include "dfr/control/assumptions.h"
#include "dfr/control/certificate.h"
#include "dfr/control/guided_policy.h"
#include "dfr/core/trajectory.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/guided_recovery.h"
#include "dfr/safety/task_model.h"

namespace dfr::apps::planar {

/// What may be varied of the methods.
struct MethodOptions {
  /// Width of guided recovery's kernel, in whitened units.
  double gamma = kernel::WhitenedSupportOptions().svm.gamma;
  bool whitening = true;
  bool phase_whitening = true;
  bool hold_ended = true;
  int window = 2;
  control::GuidedOptions guided = {};
  double raw_gamma = 0.0;         ///< Width of the published support's kernel; 0: the task's.
  double certified_gamma = 0.35;  ///< Width of the certified modes' kernel, in standard deviations.
  double gain_factor = 1.0;       ///< Safety factor on an estimated K or eps.
  /// KKT violation at which every fit ends; 0: 1e-4 for the published support, 1e-6 for others.
  double tolerance = 0.0;
};

/// How the model of a planar task is fitted.
[[nodiscard]] safety::TaskOptions TaskOptionsOf(const Task& task, const MethodOptions& options);

/// What the certified modes know. All features have one common scale, so that |dz| is |dx| times
/// that factor.
/// @throws std::invalid_argument if the demonstrations do not suffice.
[[nodiscard]] safety::GuidedRecovery FitCertified(const Task& task,
                                                  std::span<const core::Trajectory> demonstrations,
                                                  const MethodOptions& options);

/// The certificate of `kind` on FitCertified(). Its K is the task's where that is known, else
/// `gain`; its eps is `direction_error`. Both estimates are taken `factor` times.
[[nodiscard]] control::Certificate CertificateOf(const Task& task,
                                                 const safety::GuidedRecovery& certified,
                                                 const control::EstimatedConstant& gain,
                                                 const control::EstimatedConstant& direction_error,
                                                 double factor,
                                                 control::CertificateKind kind) noexcept;

}  // namespace dfr::apps::planar
