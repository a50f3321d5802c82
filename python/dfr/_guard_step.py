"""A guard as a step of a LeRobot pipeline."""

from __future__ import annotations

from typing import Any, Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from dfr._core import Guard


def _to_numpy(values: Any) -> NDArray[np.float64]:
    if hasattr(values, "detach"):  # torch tensor
        values = values.detach().cpu().numpy()
    return np.asarray(values, dtype=np.float64)


def _like(values: NDArray[np.float64], original: Any) -> Any:
    if hasattr(original, "new_tensor"):  # keeps type and device
        return original.new_tensor(values)
    return values.astype(np.asarray(original).dtype)


class GuardStep:
    """Filters the action of a transition, with the interface of LeRobot's `ProcessorStep`.

    A transition is a mapping with "observation" and "action", like LeRobot's `EnvTransition`. The
    step returns a copy with the action to apply and the guard's decision in
    `transition["info"]["guard"]`. The action has the shape (n,) or (1, n). The guard needs the
    current state for each decision. From a chunk (1, k, n), each call therefore takes one action, in
    order; `reset` and `next_chunk` return to the front of a chunk.

    LeRobot need not be installed. Call `reset` at the start of each episode.

    Parameters
    ----------
    guard : Guard
        Its layout must use the names of the observation's features, for example
        "observation.state", as `guard fit` does for a LeRobot dataset.
    positions : sequence of int or None, optional
        For actions that are target positions. Entry k of an action is a target for entry
        positions[k] of the guard's state. None leaves the entry unchanged; zero must then hold it
        still. The guard filters the target minus the current position, and the step adds the
        position to the result: a halt holds the pose at that time. Required for a guard that was
        fitted with differences.
    on_alarm : callable(info), optional
        Called once when an alarm starts, and again only after it has ended; for example to call a human.
    on_halt : callable(info), optional
        Called once when the guard halts in an episode.

    Raises
    ------
    ValueError
        If `positions` does not have one entry per entry of an action, or an entry is out of range.
    """

    def __init__(
        self,
        guard: Guard,
        *,
        positions: Sequence[int | None] | None = None,
        on_alarm: Callable[[dict[str, Any]], object] | None = None,
        on_halt: Callable[[dict[str, Any]], object] | None = None,
    ) -> None:
        self.guard = guard
        self.on_alarm = on_alarm
        self.on_halt = on_halt
        self.positions = None if positions is None else list(positions)
        if self.positions is not None:
            if len(self.positions) != guard.action_dim:
                raise ValueError(
                    f"positions has {len(self.positions)} entries; actions of this guard have {guard.action_dim}"
                )
            for entry in self.positions:
                if entry is not None and not 0 <= entry < guard.state_dim:
                    raise ValueError(f"positions names entry {entry} of a state of {guard.state_dim}")
        self._t = 0
        self._chunk = 0
        self._alarm = self._halted = False
        self._pose: NDArray[np.float64] | None = None
        self.guard.stop()  # halts until reset()

    def reset(self) -> None:
        """Start an episode."""
        self.guard.reset()
        self._t = 0
        self._chunk = 0
        self._alarm = self._halted = False
        self._pose = None

    def next_chunk(self) -> None:
        """Take the next action from the front of a new chunk."""
        self._chunk = 0

    def _state(self, observation: Any) -> NDArray[np.float64]:
        missing = [name for name, _ in self.guard.layout if name not in observation]
        if missing:
            raise ValueError(f"the observation has no {', '.join(missing)}; it has {', '.join(observation)}")
        return np.concatenate([_to_numpy(observation[name]).ravel() for name, _ in self.guard.layout])

    def _present(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the pose that actions are relative to; after a halt or for an invalid state, the last one."""
        present = np.zeros(self.guard.action_dim)
        for k, entry in enumerate(self.positions or ()):
            if entry is not None:
                present[k] = state[entry] if entry < len(state) else np.nan
        if np.isfinite(present).all() and not self._halted:
            self._pose = present
        if self._pose is None:
            raise RuntimeError("there is no pose to hold: the first state of the episode is not finite")
        return self._pose

    def __call__(self, transition: dict[Any, Any]) -> dict[Any, Any]:
        original = transition["action"]
        action = _to_numpy(original)
        if action.ndim == 3:
            if action.shape[0] != 1 or self._chunk >= action.shape[1]:
                raise ValueError(
                    f"a chunk of shape {action.shape} has no action {self._chunk}: one robot at a time, and "
                    "next_chunk() where a new chunk begins"
                )
            original = original[:, self._chunk]
            action = action[0, self._chunk]
            self._chunk += 1
        elif action.ndim == 2 and action.shape[0] != 1:
            raise ValueError(f"actions of shape {action.shape}: a guard is for one robot")
        wish = action.ravel()
        state = self._state(transition["observation"])
        present = self._present(state)
        if wish.shape == present.shape:
            wish = wish - present
        safe, info = self.guard.filter(self._t, state, wish)
        self._t += 1
        if info["alarm"] and not self._alarm and self.on_alarm is not None:
            self.on_alarm(info)
        self._alarm = info["alarm"]
        halted = info["mode"] == "halt"
        if halted and not self._halted and self.on_halt is not None:
            self.on_halt(info)
        self._halted = halted
        shape = np.shape(original) if np.size(original) == safe.size else safe.shape
        result = dict(transition)
        result["action"] = _like((safe + present).reshape(shape), original)
        result["info"] = {**(transition.get("info") or {}), "guard": info}
        return result

    def transform_features(self, features: Any) -> Any:
        """Return `features`: an action keeps its shape."""
        return features

    def get_config(self) -> dict[str, Any]:
        """Return the settings for a pipeline to store; the guard has a separate file."""
        return {"positions": self.positions}

    def state_dict(self) -> dict[str, Any]:
        """Return nothing: `Guard.save` saves the guard."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Load nothing."""
