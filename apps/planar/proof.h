#pragma once

#include <cstdint>

#include "dfr/control/certificate.h"

namespace dfr::apps::planar {

/// What a stress of a certified mode saw.
struct ProofResult {
  std::int64_t controls = 0;    ///< Applied, probes and recoveries included.
  std::int64_t left = 0;        ///< States outside the union of all B_t afterwards.
  std::int64_t violations = 0;  ///< Halts by HaltCause::kViolated: false alarms here.
  std::int64_t probes = 0;
  std::int64_t recoveries = 0;
  std::int64_t filtered = 0;  ///< Learned controls that were changed before they passed.
  std::int64_t episodes = 0;
  std::int64_t phases = 0;  ///< Advances of the phase.
  double least = 0.0;       ///< Least max_t l_t seen after a control.
};

/// Drives a certified controller for `steps` controls with policies and plants that do their worst
/// within its assumption: supports of different shapes that wander with t, policies that run for
/// the boundary, straight on, or anywhere; plants that turn the control at random, or always
/// towards the nearest outside, by K |u| or eps |u|.
[[nodiscard]] ProofResult Prove(control::CertificateKind kind, std::int64_t steps,
                                std::uint64_t seed);

}  // namespace dfr::apps::planar
