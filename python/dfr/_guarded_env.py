"""A guard around an environment with Gymnasium's interface."""

from __future__ import annotations

import copy
import warnings
from typing import Any, Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dfr._core import Guard

try:
    import gymnasium
except ImportError:

    class Wrapper:
        """The part of gymnasium.Wrapper that GuardedEnv needs, for use without Gymnasium."""

        def __init__(self, env: Any) -> None:
            self.env = env

        def __getattr__(self, name: str) -> Any:
            if name == "env":  # during unpickling
                raise AttributeError(name)
            return getattr(self.env, name)

    def _as_env(env: Any) -> Any:
        return env

else:
    Wrapper = gymnasium.Wrapper  # type: ignore[misc]

    class _Env(gymnasium.Env):  # type: ignore[misc]
        """Makes a gymnasium.Env of an environment that only has its interface."""

        def __init__(self, env: Any) -> None:
            self.env = env
            for name in ("action_space", "observation_space", "metadata", "render_mode", "spec"):
                if hasattr(env, name):
                    setattr(self, name, getattr(env, name))

        def __getattr__(self, name: str) -> Any:
            if name == "env":  # during unpickling
                raise AttributeError(name)
            return getattr(self.env, name)

        def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
            return self.env.reset(seed=seed, options=options)

        def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
            return self.env.step(action)

        def render(self) -> Any:
            return self.env.render()

        def close(self) -> None:
            if hasattr(self.env, "close"):
                self.env.close()

    def _as_env(env: Any) -> Any:
        return env if isinstance(env, gymnasium.Env) else _Env(env)


def _limits_of(space: Any, size: int) -> Any:
    """Return, for each of the `size` entries of an action, the largest c with +-c within its bounds."""
    if space is None:
        return np.inf
    dtype = getattr(space, "dtype", None)
    low, high = getattr(space, "low", None), getattr(space, "high", None)
    bounded = low is not None and high is not None
    if not np.issubdtype(dtype, np.floating) if dtype is not None else not bounded:
        raise ValueError(
            f"the environment's action_space is {space}: a guard needs one array of continuous actions. Flatten a "
            "space of several parts, for example with gymnasium.spaces.utils.flatten_space."
        )
    if not bounded:
        return np.inf
    if np.size(low) != size:
        raise ValueError(f"the environment's actions have {np.size(low)} entries, but the guard's have {size}")
    bounds = np.minimum(-np.ravel(low).astype(float), np.ravel(high).astype(float))
    k = int(np.argmin(bounds))
    if not bounds[k] > 0.0:
        raise ValueError(
            f"entry {k} of the environment's actions lies in [{np.ravel(low)[k]:g}, {np.ravel(high)[k]:g}]: a guard "
            "needs a negative lower and a positive upper bound, because a zero action must hold the robot still. "
            "Rescale actions, for example with gymnasium.wrappers.RescaleAction."
        )
    return bounds


def _checked(result: Any, count: int, method: str, values: str) -> Any:
    """Return the values of the environment's `method`; raise TypeError if they are those of another interface."""
    if isinstance(result, (tuple, list)) and len(result) == count and hasattr(result[-1], "keys"):
        return result
    got = f"{len(result)} values" if isinstance(result, tuple) else f"one {type(result).__name__}"
    if isinstance(result, tuple) and len(result) == count:
        got = f"info of type {type(result[-1]).__name__}"
    raise TypeError(
        f"the environment's {method}() returned {got}, not ({values}) with a dict as info, as in Gymnasium. "
        "Convert an environment of the older Gym, for example with the package shimmy."
    )


def _copied(state: Any) -> Any:
    """Return a copy of a state that the caller cannot change in place."""
    try:
        return copy.deepcopy(state.detach() if hasattr(state, "detach") else state)
    except Exception:  # a view of memory or a list of tensors in a graph, for example
        return np.array(state)


class GuardedEnv(Wrapper):
    """Passes actions to an environment through a guard.

    With Gymnasium installed, this class is a `gymnasium.Wrapper` for any of its environments. It also
    accepts an environment that has only Gymnasium's `reset` and `step`, and works without Gymnasium.
    Without Gymnasium, all other attributes come from the environment.

    When the guard halts, the environment receives a zero action, and the episode is truncated. After the end
    of an episode the guard halts until `reset`. If a wrapper resets the environment, put the guard inside
    that wrapper.

    Parameters
    ----------
    env : object
        With `reset(seed=None, options=None) -> (obs, info)` and
        `step(action) -> (obs, reward, terminated, truncated, info)`.
    guard : Guard
        Guard for states of this environment. Use one guard per environment.
    state : callable(obs) -> array_like, optional
        Converts an observation to the guard's state. By default, an observation is the state, or a
        mapping with the names of the guard's layout: {"object": ..., "tip": ...}.

    Raises
    ------
    TypeError
        If `env` has no `reset` or `step` or is a vector of environments, or `guard` is not a Guard.
    ValueError
        If the environment's `action_space` is not one array of continuous actions, has a size other than the
        guard's actions, or does not include both signs.

    Notes
    -----
    The environment must apply the guard's action in full. If its `action_space` has tighter bounds
    than `guard.settings["action_limit"]`, the attribute `guard` is a copy of the guard with the
    tighter limit for each entry.

    `step` adds the guard's decision as `info["guard"]` and the applied action as `info["action"]`.
    """

    def __init__(self, env: Any, guard: Guard, state: Callable[[Any], ArrayLike] | None = None) -> None:
        for name in ("reset", "step"):
            if not callable(getattr(env, name, None)):
                raise TypeError(f"env has no {name}(): an environment with Gymnasium's interface is needed, not {env!r}")
        if hasattr(env, "num_envs"):
            raise TypeError(
                f"env is a vector of {env.num_envs} environments, but a guard filters one: wrap each environment "
                "before combining them into a vector"
            )
        super().__init__(_as_env(env))
        if not isinstance(guard, Guard):
            raise TypeError(f"guard must be a dfr.Guard, not {guard!r}: dfr.Guard.load(path) reads one")
        own = np.array(guard.settings["action_limit"])
        limits = _limits_of(getattr(self.env, "action_space", None), own.size)
        if np.any(limits < own):
            guard = guard.with_settings(action_limit=np.minimum(limits, own))
        self.guard = guard
        self._state = state if state is not None else self._from_observation
        self._observed: ArrayLike = np.empty(0)
        self._t = 0
        self._ended = False

    def _from_observation(self, obs: Any) -> ArrayLike:
        if not hasattr(obs, "keys"):
            return np.ravel(obs)
        missing = [name for name, _ in self.guard.layout if name not in obs]
        if missing:
            raise ValueError(
                f"the observation has no {', '.join(missing)}; it has {', '.join(obs)}. "
                "Give GuardedEnv a function state(obs)."
            )
        # np.concatenate would forget masks; the guard refuses masked entries.
        return np.ma.concatenate([np.ravel(obs[name]) for name, _ in self.guard.layout])

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode of the environment and of the guard, both with `seed`; for the guard, None means 0."""
        self.guard.stop()  # remains halted if the environment raises
        obs, info = _checked(self.env.reset(seed=seed, options=options), 2, "reset", "obs, info")
        self._observe(obs)
        self.guard.reset(0 if seed is None else seed)
        self._t = 0
        self._ended = False
        return obs, dict(info)

    def _observe(self, obs: Any) -> None:
        self._observed = _copied(self._state(obs))

    def step(self, action: ArrayLike) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Apply the filtered `action`. If the environment raises, the guard halts until `reset`."""
        safe, verdict = self.guard.filter(self._t, self._observed, np.ravel(action))
        self._t += 1
        if self._ended:
            verdict["why"] = (
                "the episode has ended: call reset() before the next step. If a wrapper resets the environment, put "
                "the guard inside that wrapper"
            )
            warnings.warn(verdict["why"], RuntimeWarning, stacklevel=2)
        applied: NDArray[Any] = safe.copy()
        space = getattr(self.env, "action_space", None)
        if getattr(space, "dtype", None) is not None:
            applied = safe.astype(space.dtype).reshape(getattr(space, "shape", safe.shape))
        try:
            obs, reward, terminated, truncated, info = _checked(
                self.env.step(applied), 5, "step", "obs, reward, terminated, truncated, info"
            )
            self._observe(obs)
        except BaseException:
            self.guard.stop()
            raise
        halted = verdict["mode"] == "halt"
        if terminated or truncated:
            self.guard.stop()
            self._ended = True
        return obs, reward, terminated, truncated or halted, {**info, "guard": verdict, "action": safe}
