#!/usr/bin/env python3
"""Compares methods on your own plant in Python, over trials, in several processes or shards.

usage: own_experiment.py experiment --trials 5 --threads 2 --out out/corridor
"""

import numpy as np

import dfr

HALF_WIDTH, END = 0.2, 3.0


def centre(x):
    return 0.3 * np.sin(2.0 * x)


class Tip:
    """A tip in a winding corridor. Actions of 1 are steps of 0.1."""

    def reset(self, seed):
        self.at = np.array([0.0, 0.05 * np.random.default_rng(seed).normal()])
        self.collided = False

    def step(self, action):
        self.at = self.at + 0.1 * np.clip(action, -1.0, 1.0)
        self.collided |= abs(self.at[1] - centre(self.at[0])) > HALF_WIDTH

    def observe(self):
        return self.at

    @property
    def completed(self):
        return self.at[0] >= END

    def render(self):  # for films only: an RGB picture
        y, x = np.mgrid[0.6:-0.6:120j, -0.2:3.2:340j]
        walls, tip = abs(y - centre(x)) > HALF_WIDTH, np.hypot(x - self.at[0], y - self.at[1]) < 0.04
        colours = np.array([[255, 255, 255], [240, 180, 180], [40, 40, 40]], dtype=np.uint8)
        return colours[np.where(tip, 2, walls.astype(int))]


class Corridor(dfr.Experiment):
    """Recovery of a policy that cuts corners, in a corridor."""

    demonstrations = (20, 60)
    parameters = {"ahead": 0.8}  # an option --ahead, also a key of configurations and grids

    def plant(self):
        return Tip()

    def demonstrate(self, seed):
        tip, rng = Tip(), np.random.default_rng([seed, 1])
        tip.reset(seed)
        states, actions = [tip.observe()], []
        for _ in range(40):
            x, y = states[-1]
            action = [0.8, 10.0 * (centre(x + 0.08) - y)] + 0.1 * rng.normal(size=2)
            actions.append(np.clip(action, -1.0, 1.0))  # as the plant applies it
            tip.step(actions[-1])
            states.append(tip.observe())
        return states, actions

    def guard(self, states, actions):
        return dfr.Guard.fit(states, actions, action_limit=1.0)  # the plant's limit

    def learn(self, learner, states, actions, seed):
        def policy(t, state):  # learn yours from states and actions
            way = np.array([self.parameters["ahead"], centre(state[0] + self.parameters["ahead"]) - state[1]])
            return 0.8 * way / np.linalg.norm(way)

        return policy


if __name__ == "__main__":
    Corridor().main()
