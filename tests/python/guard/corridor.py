"""Demonstrations and the plant of a point that moves right along y = 0 and rotates its actions."""

import numpy as np

SPEED, TURN, STEPS = 0.1, 0.8, 20
ROTATION = np.array([[np.cos(TURN), -np.sin(TURN)], [np.sin(TURN), np.cos(TURN)]])
LAYOUT = [("clock", 1), ("tip", 2)]


def action_for(dx, dy):
    return ROTATION.T @ np.array([dx, dy])


def demonstrations(seed, count, steps=STEPS):
    """Return lists of states (steps + 1, 3) and actions (steps, 2)."""
    rng = np.random.default_rng(seed)
    states, actions = [], []
    for _ in range(count):
        x = np.zeros((steps + 1, 3))
        u = np.zeros((steps, 2))
        x[0, 1:] = 0.05 * rng.normal(), 0.1 * rng.normal()
        for t in range(steps):
            u[t] = action_for(SPEED, -0.3 * x[t, 2] + 0.05 * rng.normal())
            x[t + 1, 0] = t + 1
            x[t + 1, 1:] = x[t, 1:] + ROTATION @ u[t]
        states.append(x)
        actions.append(u)
    return states, actions


class Corridor:
    """An environment with Gymnasium's methods, but without Gymnasium. The walls are at y = +-0.6."""

    def __init__(self, as_dict=False):
        self.as_dict = as_dict

    def _observe(self):
        return {"tip": self.x[1:].copy(), "clock": self.x[:1].copy()} if self.as_dict else self.x.copy()

    def reset(self, *, seed=None, options=None):
        self.x = np.zeros(3)
        self.x[2] = 0.1 * np.random.default_rng(seed).normal()
        return self._observe(), {"options": options}

    def step(self, action):
        self.x[0] += 1
        self.x[1:] += ROTATION @ action
        hit = abs(self.x[2]) > 0.6
        return self._observe(), float(not hit), bool(hit or self.x[1] >= 1.8), False, {"hit": hit}
