"""Writes demonstrations of a task in robomimic's layout with h5py. Replace the task with your robot.

usage: record_demonstrations.py FILE
"""

import json
import sys

import h5py
import numpy as np


class Corridor:
    """A tip in a winding corridor. Actions are steps: zero holds the tip still."""

    HALF_WIDTH, END = 0.2, 3.0

    def __init__(self, rng):
        self.tip = np.array([0.0, 0.05 * rng.normal()])

    @staticmethod
    def centre(x):
        return 0.3 * np.sin(2.0 * x)

    def step(self, action):
        self.tip = self.tip + np.clip(action, -0.1, 0.1)

    @property
    def collided(self):
        return abs(self.tip[1] - self.centre(self.tip[0])) > self.HALF_WIDTH

    @property
    def completed(self):
        return self.tip[0] >= self.END


def demonstrate(rng):
    """Return states (T + 1, 2) and actions (T, 2) of a supervisor that stays near the centre line."""
    world = Corridor(rng)
    states, actions = [world.tip], []
    while not world.completed:
        ahead = world.tip[0] + 0.06
        action = np.array([0.06, world.centre(ahead) - world.tip[1]]) + 0.01 * rng.normal(size=2)
        action = np.clip(action, -0.1, 0.1)  # recorded as the world applies it
        world.step(action)
        actions.append(action)
        states.append(world.tip)
    return np.array(states), np.array(actions)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        print("usage: record_demonstrations.py FILE.hdf5", file=sys.stderr)
        sys.exit(2)
    rng = np.random.default_rng(1)
    with h5py.File(sys.argv[1], "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps({"env_name": "Corridor", "type": 2, "env_type": 2, "env_kwargs": {}})
        total = 0
        for i in range(60):
            states, actions = demonstrate(rng)
            demo = data.create_group(f"demo_{i}")
            demo.attrs["num_samples"] = len(actions)
            demo["actions"] = actions
            demo["states"] = states[:-1]
            demo["obs/tip"] = states[:-1]  # before each action
            demo["next_obs/tip"] = states[1:]  # after each action
            demo["rewards"] = np.zeros(len(actions))
            demo["dones"] = np.arange(1, len(actions) + 1) == len(actions)
            total += len(actions)
        data.attrs["total"] = total
