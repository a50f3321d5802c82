"""Units of an experiment: one learned policy, its guards and their episodes."""

from __future__ import annotations

import random
import struct
import time
import zlib
from typing import TYPE_CHECKING, Any, NamedTuple, Sequence, cast

import numpy as np
from numpy.typing import NDArray

from dfr import _core

if TYPE_CHECKING:
    from dfr._core import GuardInfo, Strategy
    from dfr._experiment import Experiment

BASELINE = "baseline"

# Streams of the experiment's seed; 0 and 1 are for start states and controllers.
_DEMONSTRATIONS, _LEARNING = 2, 3


class Episode(NamedTuple):
    """Result of `Experiment.replay` for one method."""

    outcome: str
    """"completed", "halted" or "collided"."""
    cause: str
    """Reason for the halt, or source of the action that collided; empty if completed."""
    states: NDArray[np.float64]
    """(n_actions + 1, state_dim)"""
    actions: NDArray[np.float64]
    """(n_actions, action_dim): the applied actions."""
    infos: list[GuardInfo]
    """The guard's info on each action; empty for the baseline."""


def _says(value: Any) -> bool:
    return bool(value() if callable(value) else value)


def _seed(seed: int) -> None:
    """Seed the interpreter's and NumPy's generators, for code that draws from them."""
    random.seed(seed)
    np.random.seed(seed % 2**32)


def _recovers(episode: Episode) -> list[bool]:
    """Return True for each action that a recovery chose, False for the others."""
    infos = episode.infos[: len(episode.actions)]
    return [info["mode"] in ("probe", "recovery") for info in infos] or [False] * len(episode.actions)


def _picture(plant: Any) -> NDArray[np.uint8]:
    picture = np.asarray(plant.render())
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        raise ValueError(
            f"render() must return an RGB array (height, width, 3) of uint8, not {picture.shape} of {picture.dtype}"
        )
    return picture.copy()


def _animation(films: list[list[NDArray[np.uint8]]]) -> bytes:
    """Return pictures side by side as an animated PNG, 15 per second; shorter films hold their last picture."""
    length = max(map(len, films))
    numbers = [*range(0, length - 1, length // 240 + 1), length - 1]
    shapes = {picture.shape for frames in films for picture in frames}
    if len(shapes) > 1:
        raise ValueError(f"render() must return pictures of one size, not {sorted(shapes)}")
    height = films[0][0].shape[0]
    line = np.full((height, 4, 3), 200, dtype=np.uint8)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    parts = []
    sequence = 0
    for i in numbers:
        panels = [p for frames in films for p in (line, frames[min(i, len(frames) - 1)])][1:]
        picture = np.concatenate(panels, axis=1)
        width = picture.shape[1]
        time_ms = 2000 if i == length - 1 else 67
        rows = np.concatenate([np.zeros((height, 1), np.uint8), picture.reshape(height, -1)], axis=1)
        data = zlib.compress(rows.tobytes())
        parts.append(chunk(b"fcTL", struct.pack(">IIIIIHHBB", sequence, width, height, 0, 0, time_ms, 1000, 0, 0)))
        sequence += 1
        if len(parts) == 1:
            parts.append(chunk(b"IDAT", data))
        else:
            parts.append(chunk(b"fdAT", struct.pack(">I", sequence) + data))
            sequence += 1
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    head += chunk(b"acTL", struct.pack(">II", len(numbers), 0))
    return b"\x89PNG\r\n\x1a\n" + head + b"".join(parts) + chunk(b"IEND", b"")


class Unit:
    """A learned unit and everything that its episodes need."""

    def __init__(
        self, experiment: Experiment, seed: int, methods: Sequence[str], trial: int, demonstrations: int, learner: str
    ) -> None:
        states, actions = _demonstrations(experiment, seed, trial, demonstrations)
        learning = _core.derive_seed(seed, _LEARNING, trial, 0)
        _seed(learning)
        self.policy = experiment.learn(learner, states, actions, learning)
        _seed(learning)
        guard = experiment.guard(*_demonstrations(experiment, seed, trial, demonstrations))
        self.support = guard
        # with_settings() rejects an invalid strategy and names it.
        strategies = cast("list[Strategy]", methods)
        self.guards = [None if m == BASELINE else guard.with_settings(strategy=m) for m in strategies]
        self.plant = experiment.plant()

    def _observe(self) -> NDArray[np.float64]:
        return np.array(self.plant.observe(), dtype=np.float64).ravel()

    def accepts(self, start_seed: int) -> bool:
        """Return True if the start state is inside the support. Other start states are drawn again."""
        _seed(start_seed)
        self.plant.reset(start_seed)
        return bool(self.support.decision(0, self._observe()) >= 0.0)

    def run(self, method: int, start_seed: int, controller_seed: int) -> tuple[str, str, int, int, int, float]:
        begin = time.process_time()
        episode = self.episode(method, start_seed, controller_seed)
        recovery = sum(_recovers(episode))
        changed = sum(info["changed"] for info in episode.infos[: len(episode.actions)])
        return episode.outcome, episode.cause, len(episode.actions), recovery, changed, time.process_time() - begin

    def film(self, methods: list[int], start_seed: int, controller_seed: int, pictures: bool) -> tuple[list[Any], bytes]:
        """Return outcome, states and recovery flags of each method's episode, and an animation.

        The animation is empty if the plant has no pictures, which is an error if `pictures` is set.
        """
        renders = hasattr(self.plant, "render")
        if pictures and not renders:
            raise ValueError(
                "the plant has no pictures: give its class a method render() that returns an RGB array "
                "(height, width, 3) of uint8, or use --film FILE.html, a page of the states"
            )
        episodes: list[Any] = []
        films = []
        for method in methods:
            frames: list[NDArray[np.uint8]] = []
            episode = self.episode(method, start_seed, controller_seed, frames if renders else None)
            recovery = _recovers(episode)
            told = (episode.outcome, episode.cause, len(episode.actions), sum(recovery), 0, 0.0)
            episodes.append((told, episode.states, recovery))
            films.append(frames)
        return episodes, _animation(films) if renders else b""

    def episode(
        self, method: int, start_seed: int, controller_seed: int, frames: list[NDArray[np.uint8]] | None = None
    ) -> Episode:
        """Run one episode, and append the plant's picture of each state to `frames`."""
        guard = self.guards[method]
        _seed(start_seed)
        self.plant.reset(start_seed)
        if hasattr(self.policy, "reset"):
            self.policy.reset(start_seed)
        if guard is not None:
            guard.reset(controller_seed)
        states, actions, infos = [self._observe()], [], []
        if frames is not None:
            frames.append(_picture(self.plant))
        cause, chooser = "", "policy"
        while not (_says(self.plant.collided) or _says(self.plant.completed)):
            t = len(actions)
            if guard is None and t == self.support.settings["horizon"]:
                cause = "time-up"
                break
            action = np.array(self.policy(t, states[-1].copy()), dtype=np.float64).ravel()
            if guard is not None:
                action, info = guard.filter(t, states[-1], action)
                infos.append(info)
                if info["mode"] == "halt":
                    cause = info["reason"]
                    break
                chooser = info["reason"] if info["changed"] or info["mode"] != "policy" else "policy"
            self.plant.step(action.copy())
            actions.append(action)
            states.append(self._observe())
            if frames is not None:
                frames.append(_picture(self.plant))
        outcome = "collided" if _says(self.plant.collided) else "halted" if cause else "completed"
        if outcome == "collided":
            cause = chooser
        shape = (len(actions), self.support.action_dim)
        return Episode(outcome, cause, np.array(states), np.reshape(actions, shape), infos)


def _demonstrations(experiment: Experiment, seed: int, trial: int, count: int) -> tuple[list[Any], list[Any]]:
    """Return the first `count` demonstrations of a trial. Only the latest trial's demonstrations are cached."""
    key = (tuple(experiment.parameters.items()), seed, trial)
    if experiment._kept[0] != key:
        experiment._kept = (key, [])
    kept = experiment._kept[1]
    while len(kept) < count:
        one = _core.derive_seed(seed, _DEMONSTRATIONS, trial, len(kept))
        _seed(one)
        states, actions = experiment.demonstrate(one)
        kept.append((np.array(states, dtype=np.float64), np.array(actions, dtype=np.float64)))
    # The caller's functions may change their arguments in place.
    return [states.copy() for states, _ in kept[:count]], [actions.copy() for _, actions in kept[:count]]
