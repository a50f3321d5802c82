/* A guard in C, for languages that call C: see docs/guard.md for what a guard does and assumes.
 *
 * The binary interface of libdfr_guard.so.0 is stable: functions are added, never changed or
 * removed, and dfr_guard_verdict grows at its end only (see its member size). No function throws or
 * ends the process. One dfr_guard belongs to one thread at a time; guards of several threads are
 * independent. */
#ifndef DFR_GUARD_H_
#define DFR_GUARD_H_

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct dfr_guard dfr_guard;

/* Who chose the action. NOLINTBEGIN(readability-identifier-naming): C has no scopes. */
enum {
  DFR_GUARD_POLICY = 0,   /* The policy; perhaps changed, see dfr_guard_verdict.changed. */
  DFR_GUARD_PROBE = 1,    /* The guard, to find out how states answer. */
  DFR_GUARD_RECOVERY = 2, /* The guard, to lead back inside. */
  DFR_GUARD_HALT = 3      /* Nobody: zero, and so until dfr_guard_reset(). */
};
/* NOLINTEND(readability-identifier-naming) */

/* What a guard decided. */
typedef struct {
  uint32_t size;      /* Set by the caller: sizeof(dfr_guard_verdict). No more is written. */
  int32_t mode;       /* DFR_GUARD_POLICY and so on. */
  int32_t changed;    /* 1 if the action differs from the policy's. */
  int32_t alarm;      /* 1 if the state is further outside than demonstrations are. */
  int32_t step;       /* The time step that the strategy is in: that of g and threshold. */
  int32_t alarm_step; /* The time step of the demonstrations that the state fits best. */
  double g;           /* Positive inside what was demonstrated; NaN if the state is not one. */
  double threshold;   /* The policy's action passes where g is at least this; NaN: no gate. */
  const char* reason; /* One word, as in docs/guard.md; lives as long as the process. */
} dfr_guard_verdict;

/* Reads a file that `guard fit` wrote. NULL if it cannot; dfr_guard_last_error() says why. */
dfr_guard* dfr_guard_load(const char* path);
/* Frees a guard; NULL is ignored. */
void dfr_guard_free(dfr_guard* guard);

/* Entries of a state and of an action; time steps that have an estimate of their own. 0 for NULL.
 */
int32_t dfr_guard_state_dim(const dfr_guard* guard);
int32_t dfr_guard_action_dim(const dfr_guard* guard);
int32_t dfr_guard_num_steps(const dfr_guard* guard);

/* Starts an episode. All that is random follows from the seed. Real-time safe. */
void dfr_guard_reset(dfr_guard* guard, uint64_t seed);
/* Halts from outside: actions are zero until dfr_guard_reset(). Real-time safe. */
void dfr_guard_stop(dfr_guard* guard);

/* Writes what to apply instead of `action` to `safe` (action_size entries; may be `action`).
 * `t` is 0 in the first call after a reset and goes up by one with each. A state or action of the
 * wrong size, NULL or not finite, or another t, halts: `safe` is then all zero.
 * `verdict` may be NULL. Returns its mode. Neither allocates nor locks: real-time safe. */
int32_t dfr_guard_filter(dfr_guard* guard, int32_t t, const double* state, size_t state_size,
                         const double* action, size_t action_size, double* safe,
                         dfr_guard_verdict* verdict);

/* Writes g of `count` states, one after another in `states` (count x state_dim), to `g`; t[i] is
 * the time step of state i, from 0; steps after the last demonstrated one use the last estimate. A
 * state with a feature that is not finite gives -infinity. Returns 0, or -1 if a pointer is NULL or
 * a time step negative; dfr_guard_last_error() says which. */
int32_t dfr_guard_decision(const dfr_guard* guard, size_t count, const int32_t* t,
                           const double* states, double* g);

/* What went wrong in this thread last; "" if nothing has. Valid until the next failure. */
const char* dfr_guard_last_error(void);

/* The library's version, "0.1.0". */
const char* dfr_guard_version(void);

#ifdef __cplusplus
}
#endif

#endif /* DFR_GUARD_H_ */
