#pragma once

#include <array>
#include <cstdint>

namespace dfr::study::planar {

/// Results of a stress test of certified-direction.
struct ProofResult {
  std::int64_t controls = 0;  ///< Number of applied controls, including probes and recoveries.
  std::int64_t left = 0;      ///< Number of controls that led out of the union of all B_t.
  /// Number of halts by HaltCause::kViolated: false alarms if the controller's assumptions hold.
  std::int64_t violations = 0;
  std::int64_t probes = 0;
  std::int64_t recoveries = 0;
  std::int64_t filtered = 0;  ///< Number of learned controls changed before they passed.
  std::int64_t episodes = 0;
  std::int64_t phases = 0;  ///< Number of advances of the phase.
  double least = 0.0;       ///< Smallest max_t l_t after a control.
};

/// A mistake in a certified controller that the test must detect.
enum class Mutation {
  kNone,
  kShare,      ///< Controls are larger by a factor of 1 + 1e-5 than certified.
  kConstant,   ///< eps is 2 % below the plant's error.
  kCurvature,  ///< The curvature bound is 2 % too small.
  kLostPhase,  ///< One of the controller's supports is not in the union.
};
[[nodiscard]] const char* Name(Mutation mutation) noexcept;
inline constexpr std::array kMutations = {Mutation::kNone, Mutation::kShare, Mutation::kConstant,
                                          Mutation::kCurvature, Mutation::kLostPhase};

/// Options for Prove().
struct ProofOptions {
  std::int64_t steps = 1'000'000;
  std::uint64_t seed = 1;
  Mutation mutation = Mutation::kNone;
  int most_dimensions = 12;  ///< Worlds have 2 to this number of dimensions.
  double state_error = 0.0;  ///< States are observed with errors of up to this length.
  double assumed = 1.0;      ///< The controller's eps as a multiple of the plant's.
};

/// Runs a certified controller for `options.steps` controls with adversarial policies and plants
/// within its assumption. Supports have different shapes and move with t. In every third world they
/// are single kernels, which attain the bounds. Policies move away from the origin, along one axis,
/// or randomly. Plants add an error of eps |u|: at random, away from the certifying support, or to
/// where the largest l over all phases is least.
[[nodiscard]] ProofResult Prove(const ProofOptions& options);

}  // namespace dfr::study::planar
