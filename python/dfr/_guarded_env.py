"""A guard around an environment of Gymnasium's shape."""

from __future__ import annotations

from typing import Any, Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dfr._core import Guard


class GuardedEnv:
    """Passes actions on to an environment through a guard.

    The environment needs Gymnasium's `reset` and `step`; Gymnasium itself need not be installed.
    Attributes that are not defined here are the environment's.

    Where the guard halts, the environment is given the action zero, and the episode is truncated.

    Parameters
    ----------
    env : object
        With `reset(seed=None, options=None) -> (obs, info)` and
        `step(action) -> (obs, reward, terminated, truncated, info)`.
    guard : Guard
        Of states of this environment. One for each environment.
    state : callable(obs) -> array_like, optional
        Makes the guard's state of an observation. Without it an observation is the state, or a
        mapping of the guard's layout: {"object": ..., "tip": ...}.

    `step` adds what the guard decided to its info, as `info["guard"]`, and the action that was
    applied, as `info["action"]`.
    """

    def __init__(self, env: Any, guard: Guard, state: Callable[[Any], ArrayLike] | None = None) -> None:
        self.env = env
        self.guard = guard
        self._state = state if state is not None else self._from_observation
        self._observed: ArrayLike = np.empty(0)
        self._t = 0

    def __getattr__(self, name: str) -> Any:
        if name == "env":  # while being unpickled
            raise AttributeError(name)
        return getattr(self.env, name)

    def _from_observation(self, obs: Any) -> ArrayLike:
        if not hasattr(obs, "keys"):
            return np.ravel(obs)
        missing = [name for name, _ in self.guard.layout if name not in obs]
        if missing:
            raise ValueError(
                f"the observation has no {', '.join(missing)}; it has {', '.join(obs)}. "
                "Give GuardedEnv a function state(obs)."
            )
        return np.concatenate([np.ravel(obs[name]) for name, _ in self.guard.layout])

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode of the environment and of the guard, the latter with the same seed or 0."""
        obs, info = self.env.reset(seed=seed, options=options)
        self.guard.reset(0 if seed is None else seed)
        self._observed = self._state(obs)
        self._t = 0
        return obs, dict(info)

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Apply what the guard makes of `action`."""
        safe, verdict = self.guard.filter(self._t, self._observed, action)
        self._t += 1
        applied: NDArray[Any] = safe
        dtype = getattr(getattr(self.env, "action_space", None), "dtype", None)
        if dtype is not None:
            applied = safe.astype(dtype)
        obs, reward, terminated, truncated, info = self.env.step(applied)
        self._observed = self._state(obs)
        halted = verdict["mode"] == "halt"
        return obs, reward, terminated, truncated or halted, {**info, "guard": verdict, "action": safe}
