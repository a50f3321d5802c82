#include "trpo_options.h"

#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "dfr/core/contract.h"
#include "mlp/spend_weights.h"

namespace dfr::imitation::internal {

TrpoOptions CheckedTrpoOptions(TrpoOptions o) {
  DFR_THROW_UNLESS(o.control_limit > 0.0,
                   "TRPO control_limit must be positive, not " << o.control_limit);
  DFR_THROW_UNLESS(o.horizon > 0, "TRPO horizon must be positive, not " << o.horizon);
  DFR_THROW_UNLESS(o.batch_steps > 1, "TRPO batch_steps must be at least 2, not " << o.batch_steps);
  DFR_THROW_UNLESS(o.discount >= 0.0 && o.discount <= 1.0,
                   "TRPO discount must lie in [0, 1], not " << o.discount);
  DFR_THROW_UNLESS(o.gae_lambda >= 0.0 && o.gae_lambda <= 1.0,
                   "TRPO gae_lambda must lie in [0, 1], not " << o.gae_lambda);
  DFR_THROW_UNLESS(o.max_kl > 0.0, "TRPO max_kl must be positive, not " << o.max_kl);
  DFR_THROW_UNLESS(o.cg_iterations > 0,
                   "TRPO cg_iterations must be positive, not " << o.cg_iterations);
  DFR_THROW_UNLESS(o.cg_damping >= 0.0, "TRPO cg_damping must not be negative: " << o.cg_damping);
  DFR_THROW_UNLESS(std::isfinite(o.initial_log_std) && std::isfinite(o.min_log_std) &&
                       o.initial_log_std >= o.min_log_std,
                   "TRPO initial log standard deviation "
                       << o.initial_log_std << " must be finite and not below its floor "
                       << o.min_log_std);
  DFR_THROW_UNLESS(o.critic_epochs > 0 && o.critic_batch > 0 && o.critic_learning_rate > 0.0,
                   "TRPO critic needs positive epochs, batch and learning rate, not "
                       << o.critic_epochs << ", " << o.critic_batch << ", "
                       << o.critic_learning_rate);
  return o;
}

void SaveTrpoOptions(const TrpoOptions& o, core::ArchiveWriter& archive) {
  archive.Integers(o.hidden);
  archive.Integers(o.critic_hidden);
  archive.Text(o.features);
  archive.Text(o.environment);
  for (const double value : {o.control_limit, o.discount, o.gae_lambda, o.max_kl, o.cg_damping,
                             o.initial_log_std, o.min_log_std, o.critic_learning_rate}) {
    archive.Number(value);
  }
  for (const int value :
       {o.horizon, o.batch_steps, o.cg_iterations, o.critic_epochs, o.critic_batch}) {
    archive.Integer(value);
  }
  archive.Integer(static_cast<std::int64_t>(o.seed));
}

TrpoOptions LoadTrpoOptions(core::ArchiveReader& archive) {
  constexpr int kMax = std::numeric_limits<int>::max();
  TrpoOptions o;
  for (std::vector<int>* const hidden : {&o.hidden, &o.critic_hidden}) {
    *hidden = archive.Integers();
    SpendWeights(*hidden, archive);
  }
  o.features = archive.Text();
  o.environment = archive.Text();
  for (double* const value :
       {&o.control_limit, &o.discount, &o.gae_lambda, &o.max_kl, &o.cg_damping, &o.initial_log_std,
        &o.min_log_std, &o.critic_learning_rate}) {
    *value = archive.Number();
  }
  for (int* const value :
       {&o.horizon, &o.batch_steps, &o.cg_iterations, &o.critic_epochs, &o.critic_batch}) {
    *value = archive.IntegerIn(0, kMax);
  }
  o.seed = static_cast<std::uint64_t>(archive.Integer());
  return o;
}

}  // namespace dfr::imitation::internal
