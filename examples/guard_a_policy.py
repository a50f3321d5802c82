"""A policy that drifts off, and a guard that keeps it near the demonstrations."""

import numpy as np

import dfr

# Demonstrations: a tip moves to the right for 20 steps. For files, see `guard fit --help`.
rng = np.random.default_rng(1)
states, actions = [], []
for _ in range(30):
    x, u = np.zeros((21, 2)), np.zeros((20, 2))
    x[0] = 0.1 * rng.normal(size=2)
    for t in range(20):
        u[t] = [0.1, -0.3 * x[t, 1]] + 0.02 * rng.normal(size=2)
        x[t + 1] = x[t] + u[t]
    states.append(x)
    actions.append(u)
guard = dfr.Guard.fit(states, actions)  # guard.save("task.guard"), dfr.Guard.load("task.guard")

guard.reset(seed=1)
tip = np.zeros(2)
for t in range(40):
    wish = [0.09, 0.06]  # your policy
    action, info = guard.filter(t, tip, wish)
    print(f"{t:2}  g {info['g']:6.3f}  {info['reason']:8}  {action.round(3)}")
    tip = tip + action  # your robot
    if info["mode"] == "halt" or tip[0] >= 1.8:
        break
assert tip[0] >= 1.8 and abs(tip[1]) < 0.6, tip
