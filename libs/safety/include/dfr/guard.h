/* A guard in C, for languages that call C. docs/guard.md explains its use and assumptions.
 *
 * The binary interface of libdfr_guard.so.0 is stable: functions are added, never changed or
 * removed, and dfr_guard_verdict grows only at its end (see its member size). No function throws or
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

/* Source of an action. NOLINTBEGIN(readability-identifier-naming): C has no scopes. */
enum {
  DFR_GUARD_POLICY = 0,   /* The policy, possibly corrected: see dfr_guard_verdict.changed. */
  DFR_GUARD_PROBE = 1,    /* The guard, to measure the effect of an action. */
  DFR_GUARD_RECOVERY = 2, /* The guard, to keep the state inside. */
  DFR_GUARD_HALT = 3      /* No source: the action is zero until dfr_guard_reset(). */
};
/* NOLINTEND(readability-identifier-naming) */

/* Decision of a guard. */
typedef struct {
  uint32_t size;      /* Set by the caller: sizeof(dfr_guard_verdict). Limits the bytes written. */
  int32_t mode;       /* DFR_GUARD_POLICY and so on. */
  int32_t changed;    /* 1 if the action differs from the policy's. */
  int32_t alarm;      /* 1 if the state is outside, invalid, unlike demonstrations or frozen. */
  int32_t step;       /* Time step of the strategy, used for g and threshold. */
  int32_t alarm_step; /* Nearby time step whose support fits the state best. */
  double g;           /* Positive inside the support; NaN for an invalid state. */
  double threshold;   /* Level at which the policy's action passes, as a value of g; NaN: none. */
  const char* reason; /* A word of docs/glossary.md, valid for the lifetime of the process. */
} dfr_guard_verdict;

/* Loads a file of `guard fit`. Returns NULL on failure; see dfr_guard_last_error(). */
dfr_guard* dfr_guard_load(const char* path);
/* Destroys a guard. Ignores NULL. */
void dfr_guard_free(dfr_guard* guard);

/* Return the number of entries of a state and of an action, and the number of time steps with an
 * estimate; 0 for NULL. */
int32_t dfr_guard_state_dim(const dfr_guard* guard);
int32_t dfr_guard_action_dim(const dfr_guard* guard);
int32_t dfr_guard_num_steps(const dfr_guard* guard);

/* Starts an episode. `seed` determines all random choices. Real-time safe. */
void dfr_guard_reset(dfr_guard* guard, uint64_t seed);
/* Halts on request: actions are zero until dfr_guard_reset(). Real-time safe. */
void dfr_guard_stop(dfr_guard* guard);

/* Writes the action to apply instead of `action` to `safe` (action_size entries; may be `action`).
 * `t` is 0 in the first call after a reset and increases by one with each call. The guard halts,
 * and `safe` is zero, for another t and for a state or action that is NULL, of the wrong size or
 * not finite. `verdict` may be NULL. Returns the mode. Never allocates or locks: real-time safe. */
int32_t dfr_guard_filter(dfr_guard* guard, int32_t t, const double* state, size_t state_size,
                         const double* action, size_t action_size, double* safe,
                         dfr_guard_verdict* verdict);

/* Writes g of `count` states, concatenated in `states` (count x state_dim), to `g`. t[i] >= 0 is
 * the time step of state i; steps after the last demonstrated one use the last estimate. g is
 * -infinity for a state with a non-finite feature. Returns 0, or -1 on failure, for example if a
 * pointer is NULL or a time step is negative; see dfr_guard_last_error(). */
int32_t dfr_guard_decision(const dfr_guard* guard, size_t count, const int32_t* t,
                           const double* states, double* g);

/* Returns the last error of this thread; "" if there was none. Valid until the next error. */
const char* dfr_guard_last_error(void);

/* Returns the version of the library, "0.1.0". */
const char* dfr_guard_version(void);

#ifdef __cplusplus
}
#endif

#endif /* DFR_GUARD_H_ */
