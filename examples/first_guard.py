"""Runs a policy that cuts corners, with and without a guard, from the same 100 starts.

usage: first_guard.py GUARD
"""

import collections
import sys

import numpy as np
from record_demonstrations import Corridor

import dfr


def policy(tip):
    """Aims at the centre of the corridor 0.8 ahead."""
    way = np.array([0.8, Corridor.centre(tip[0] + 0.8) - tip[1]])
    return 0.08 * way / np.linalg.norm(way)


def run(seed, guard=None):
    world = Corridor(np.random.default_rng(seed))
    if guard is not None:
        guard.reset(seed)
    for t in range(200):
        if world.collided:
            return "collided"
        if world.completed:
            return "completed"
        action = policy(world.tip)
        if guard is not None:
            action, info = guard.filter(t, world.tip, action)
            if info["mode"] == "halt":
                return "halted: " + info["reason"]
        world.step(action)
    return "halted: out of time"


if len(sys.argv) != 2:
    print("usage: first_guard.py GUARD   (made by: guard fit demos.hdf5 --features obs/tip --action-limit 0.1 -o task.guard)", file=sys.stderr)
    sys.exit(2)
guard = dfr.Guard.load(sys.argv[1])
print("alone:  ", dict(collections.Counter(run(seed) for seed in range(100))))
print("guarded:", dict(collections.Counter(run(seed, guard) for seed in range(100))))
