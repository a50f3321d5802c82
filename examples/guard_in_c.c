/* A guard around a policy, in C: guard_in_c task.guard (written by fit_a_guard). */
#include <dfr/guard.h>
#include <stdio.h>

int main(int argc, char** argv) {
  dfr_guard* guard = dfr_guard_load(argc > 1 ? argv[1] : "task.guard");
  if (guard == NULL) {
    fprintf(stderr, "%s\n", dfr_guard_last_error());
    return 1;
  }
  if (dfr_guard_state_dim(guard) != 2 || dfr_guard_action_dim(guard) != 2) {
    fprintf(stderr, "this example needs a guard with 2 state and 2 action entries\n");
    return 1;
  }
  dfr_guard_reset(guard, 1);
  double tip[2] = {0.0, 0.0};
  dfr_guard_verdict verdict = {.size = sizeof(verdict)};
  for (int t = 0; t < 40 && tip[0] < 1.8; ++t) {
    double action[2] = {0.09, 0.06}; /* your policy */
    if (dfr_guard_filter(guard, t, tip, 2, action, 2, action, &verdict) == DFR_GUARD_HALT) break;
    printf("%2d  g %6.3f  %s\n", t, verdict.g, verdict.reason);
    tip[0] += action[0]; /* your robot */
    tip[1] += action[1];
  }
  dfr_guard_free(guard);
  return tip[0] >= 1.8 ? 0 : 1;
}
