"""Independent code for the part of Gymnasium 1.x that GuardedEnv uses. Debian does not package Gymnasium.

Wrapper rejects objects other than an Env, keeps the private attributes that its properties need, and forwards
attributes only through get_wrapper_attr.
"""

import numpy as np


class Box:
    def __init__(self, low, high, shape, dtype=np.float32):
        self.low, self.high = np.full(shape, low, dtype), np.full(shape, high, dtype)
        self.shape, self.dtype = shape, np.dtype(dtype)


class Env:
    spec = None
    metadata = {"render_modes": []}

    @property
    def unwrapped(self):
        return self

    def get_wrapper_attr(self, name):
        return getattr(self, name)

    def close(self):
        pass


class Wrapper(Env):
    def __init__(self, env):
        if not isinstance(env, Env):
            raise TypeError(f"not a gymnasium.Env: {type(env)}")
        self.env = env
        self._action_space = self._observation_space = self._metadata = self._cached_spec = None

    @property
    def action_space(self):
        return self.env.action_space if self._action_space is None else self._action_space

    @action_space.setter
    def action_space(self, space):
        self._action_space = space

    @property
    def observation_space(self):
        return self.env.observation_space if self._observation_space is None else self._observation_space

    @property
    def unwrapped(self):
        return self.env.unwrapped

    def get_wrapper_attr(self, name):
        return getattr(self, name) if hasattr(self, name) else self.env.get_wrapper_attr(name)

    def reset(self, *, seed=None, options=None):
        return self.env.reset(seed=seed, options=options)

    def step(self, action):
        return self.env.step(action)
