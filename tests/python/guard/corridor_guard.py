"""A guard of the corridor, and a policy that drifts out of it."""

import dfr
from corridor import LAYOUT, action_for, demonstrations

DRIFT = action_for(0.09, 0.06)


def fit(count=30, seed=1, **options):
    states, actions = demonstrations(seed, count)
    return dfr.Guard.fit(states, actions, layout=LAYOUT, features="obs/tip", **options)
