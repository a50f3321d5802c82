"""A guard as a step of a LeRobot pipeline."""

from __future__ import annotations

import hashlib
import tempfile
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, Hashable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dfr._core import Guard

if TYPE_CHECKING:
    from dfr._core import GuardInfo

try:
    from lerobot.processor import ProcessorStep
except ImportError:

    class ProcessorStep:  # type: ignore[no-redef]
        """Replacement for LeRobot's ProcessorStep, if LeRobot is not installed."""


def _to_numpy(values: Any) -> NDArray[np.float64]:
    if hasattr(values, "detach"):  # a tensor of torch; NumPy has no bfloat16
        values = values.detach().cpu().double().numpy()
    return np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan)  # halts at a masked entry


def _rounded(values: NDArray[np.float64], dtype: Any) -> NDArray[Any]:
    """Round towards zero: a result of `Guard.filter` stays within its limits."""
    nearest = values.astype(dtype)
    beyond = np.abs(nearest.astype(np.float64)) > np.abs(values)
    return np.where(beyond, np.nextafter(nearest, np.zeros_like(nearest)), nearest)


def _like(values: NDArray[np.float64], original: Any) -> Any:
    # An integer type would truncate the action, but the guard counts the exact action as applied.
    if hasattr(original, "new_tensor"):  # creates a tensor of the same type and device
        name = str(getattr(original, "dtype", "")).rpartition(".")[2]
        if name == "bfloat16":  # the upper half of a float32
            values = (_rounded(values, np.float32).view(np.uint32) & np.uint32(0xFFFF0000)).view(np.float32)
        elif name in ("float16", "float32"):
            values = _rounded(values, np.dtype(name))
        return (original if original.is_floating_point() else original.double()).new_tensor(values)
    dtype = np.asarray(original).dtype
    return _rounded(values, dtype if np.issubdtype(dtype, np.floating) else np.float64)[()]  # keeps a scalar


def _is_number(value: Any) -> bool:
    return getattr(value, "shape", ()) == () and not isinstance(value, (str, bytes)) and np.isscalar(_item(value))


def _item(value: Any) -> Any:
    return value.item() if hasattr(value, "item") else value


def _listed(name: str, values: Any) -> list[Any] | None:
    """Return the values of an option as Python's own types, which a configuration file can hold."""
    if values is None:
        return None
    if isinstance(values, (str, bytes)) or not hasattr(values, "__iter__"):
        raise TypeError(f"{name} must be a list with one entry per entry of an action, not {values!r}")
    return [_item(value) for value in values]


class GuardStep(ProcessorStep):  # type: ignore[misc]
    """Filters actions in a LeRobot pipeline. With LeRobot installed, this class is a `ProcessorStep`.

    Called with a transition (a mapping with "observation" and "action"), it returns a copy with the action to
    apply and with the decision of `Guard.filter` as `transition["info"]["guard"]`. Called with a pair
    (action, observation), like a robot_action_processor, it returns the action to apply.
    `info` has the last decision in both cases. Call `reset` at the start of each episode.

    An action is a tensor or array of n entries in any shape, or a dictionary of n numbers,
    {"shoulder_pan.pos": ...}. The result has the same form, with floating-point numbers. The guard decides in
    the present state of the robot. From a chunk (1, k, n) each call therefore takes one action, in order;
    `reset` and `next_chunk` start a new chunk.

    A transition of a policy's post-processor has no observation. In this case call `observe` with an
    observation before each action.

    Parameters
    ----------
    guard : Guard or path_like
        Its layout names the features of the observation, as `guard fit` reads them from a LeRobot dataset:
        "observation.state" and the like. A path names a guard's file. If the observation lacks one part of the layout,
        its single numbers, {"shoulder_pan.pos": ...}, replace that part; their count must match.
    positions : sequence of int or None, optional
        For actions that are target positions: entry k of an action is a target for entry positions[k] of the
        guard's state. None leaves the entry unchanged: zero must hold it still. The guard then filters target
        minus present position, and the position is added to its result: a halt holds the present pose. An angle
        with a period in `guard.periods` takes the short way to its target.
        Required for a guard that was fitted with differences: without it a target is limited as an increment.
    action_names : sequence of str, optional
        The order of the entries of a dictionary action; by default the order of the first action.
    on_alarm : callable(info), optional
        Called once when an alarm begins, and again only after it has ended, for example to call an operator.
    on_halt : callable(info), optional
        Called once when the guard halts in an episode.

    Attributes
    ----------
    info : dict or None
        The last decision of `Guard.filter`.

    Raises
    ------
    TypeError
        If `guard` is neither a guard nor a path, `positions` or `action_names` is not a list, or `on_alarm` or
        `on_halt` is not callable.
    ValueError
        If `positions` or `action_names` does not have one entry per entry of an action, or an entry is not a
        whole number, out of range or repeated.
    """

    def __init__(
        self,
        guard: Guard | str | PathLike[str],
        *,
        positions: Sequence[int | None] | None = None,
        action_names: Sequence[str] | None = None,
        on_alarm: Callable[[GuardInfo], object] | None = None,
        on_halt: Callable[[GuardInfo], object] | None = None,
    ) -> None:
        self._path = None
        if isinstance(guard, (str, PathLike)):
            self._path = fspath(guard)
            guard = Guard.load(guard)
        if not isinstance(guard, Guard):
            raise TypeError(f"guard must be a dfr.Guard or the path of one, not {guard!r}")
        for name, call in (("on_alarm", on_alarm), ("on_halt", on_halt)):
            if call is not None and not callable(call):
                raise TypeError(f"{name} must be a function of info, not {call!r}")
        self.guard = guard
        self.on_alarm = on_alarm
        self.on_halt = on_halt
        self.positions = _listed("positions", positions)
        self.action_names = _listed("action_names", action_names)
        for name, entries in (("positions", self.positions), ("action_names", self.action_names)):
            if entries is not None and len(entries) != guard.action_dim:
                raise ValueError(f"{name} has {len(entries)} entries; actions of this guard have {guard.action_dim}")
        for entry in self.positions or ():
            if entry is not None and type(entry) is not int:
                raise ValueError(f"positions contains {entry!r}, which is neither a whole number nor None")
            if entry is not None and entry not in range(guard.state_dim):
                raise ValueError(f"positions contains {entry!r}, but a state has {guard.state_dim} entries")
            if entry is not None and self.positions.count(entry) > 1:
                raise ValueError(f"positions contains {entry!r} twice")
        for name in self.action_names or ():
            if not isinstance(name, Hashable):
                raise TypeError(f"action_names must be names, not {name!r}")
            if self.action_names.count(name) > 1:
                raise ValueError(f"action_names contains {name!r} twice")
        periods = [0.0 if entry is None else guard.periods[entry] for entry in self.positions or ()]
        self._angles = np.flatnonzero(periods)
        self._periods = np.array(periods)[self._angles]
        self._forget()
        self.guard.stop()  # halts until reset()

    def _forget(self) -> None:
        self._t = 0
        self._chunk = 0
        self._alarm = self._halted = False
        self._pose: NDArray[np.float64] | None = None
        self._observed: NDArray[np.float64] | None = None
        self.info: GuardInfo | None = None

    def reset(self) -> None:
        """Start an episode."""
        self.guard.reset()
        self._forget()

    def next_chunk(self) -> None:
        """Take the next action from the front of a new chunk."""
        self._chunk = 0

    def observe(self, observation: Mapping[str, Any]) -> None:
        """Store the robot's present state for the next action, whose transition has no observation."""
        self._observed = self._state(observation)

    def _state(self, observation: Mapping[str, Any]) -> NDArray[np.float64]:
        numbers = [float(_item(value)) for value in observation.values() if _is_number(value)]
        missing = [(name, size) for name, size in self.guard.layout if name not in observation]
        if missing and (len(missing) > 1 or len(numbers) != missing[0][1]):
            raise ValueError(
                f"the observation has no {', '.join(name for name, _ in missing)}; it has "
                f"{', '.join(map(str, observation))}"
                + (f", of which {len(numbers)} are numbers; the guard needs {missing[0][1]}" if len(missing) == 1 else "")
            )
        parts = [
            _to_numpy(observation[name]).ravel() if name in observation else np.array(numbers)
            for name, _ in self.guard.layout
        ]
        for (name, size), part in zip(self.guard.layout, parts):
            if len(part) != size:
                raise ValueError(f"the observation's {name} has {len(part)} entries; the guard needs {size}")
        return np.concatenate(parts)

    def _present(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the pose that actions are relative to; after a halt, or in an invalid state, the last valid pose."""
        present = np.zeros(self.guard.action_dim)
        for k, entry in enumerate(self.positions or ()):
            if entry is not None:
                present[k] = state[entry] if entry < len(state) else np.nan
        if np.isfinite(present).all() and not self._halted:
            self._pose = present
        if self._pose is None:
            raise RuntimeError("there is no pose to hold: the first state of the episode is not finite")
        return self._pose

    def _entries(self, action: Mapping[str, Any]) -> list[str]:
        """Return the order of an action's names."""
        if self.action_names is None and len(action) == self.guard.action_dim:
            self.action_names = list(action)
        names = self.action_names or []
        if set(names) != set(action):
            raise ValueError(
                f"the action has the entries {', '.join(map(str, action))}; the guard needs "
                + (", ".join(names) if names else f"{self.guard.action_dim}: give action_names")
            )
        return names

    def _decide(
        self, wish: NDArray[np.float64], observation: Mapping[str, Any] | None, taken: int
    ) -> tuple[NDArray[np.float64], GuardInfo]:
        """Return the action to apply instead of `wish`, and the decision; `taken` actions of a chunk are used."""
        state = self._observed if observation is None else self._state(observation)
        self._observed = None
        if state is None:
            raise ValueError(
                "the transition has no observation, as in a policy's post-processor: call observe(observation) of "
                "this step before each action, or put the step into the robot_action_processor"
            )
        present = self._present(state)
        turns = np.zeros_like(present)
        if wish.shape == present.shape:
            wish = wish - present
            with np.errstate(invalid="ignore"):  # The guard halts at an infinite target.
                turns[self._angles] = self._periods * np.round(wish[self._angles] / self._periods)
                wish = wish - turns
        safe, info = self.guard.filter(self._t, state, wish)
        self._t += 1
        self._chunk += taken
        self.info = info
        alarm, halt = info["alarm"], info["mode"] == "halt"
        alarmed, halted = self._alarm, self._halted
        self._alarm, self._halted = alarm, halt
        # These calls come last, because the functions may raise or call reset().
        try:
            if alarm and not alarmed and self.on_alarm is not None:
                self.on_alarm(info)
        finally:
            if halt and not halted and self.on_halt is not None:
                self.on_halt(info)
        return (present if halt else safe + present + turns), info

    def _filter(
        self, original: Any, observation: Mapping[str, Any] | None, taken: int = 0
    ) -> tuple[Any, GuardInfo]:
        if isinstance(original, Mapping):
            names = self._entries(original)
            wish = np.array([float(_item(original[name])) for name in names])
            safe, info = self._decide(wish, observation, taken)
            filtered = dict(zip(names, safe))
            # A tensor of one number remains a tensor.
            return {
                name: _like(filtered[name].reshape(np.shape(value)), value) if hasattr(value, "shape") else float(filtered[name])
                for name, value in original.items()
            }, info
        shape = tuple(np.shape(original))
        if len(shape) == 3 and shape[:2] != (1, 1):
            if shape[0] != 1 or self._chunk >= shape[1]:
                raise ValueError(
                    f"a chunk of shape {shape} has no action {self._chunk}: call next_chunk() when a "
                    "new chunk begins, and filter one robot at a time"
                )
            return self._filter(original[:, self._chunk], observation, taken=1)
        if any(n != 1 for n in shape[:-1]):
            raise ValueError(f"actions of shape {shape}: a guard is for one robot")
        wish = _to_numpy(original)
        safe, info = self._decide(wish.ravel(), observation, taken)
        return _like(safe.reshape(shape if wish.size == safe.size else safe.shape), original), info

    def __call__(self, transition: Any) -> Any:
        if isinstance(transition, tuple):
            action, observation = transition
            return self._filter(action, observation)[0]
        self._current_transition = transition
        result = dict(transition)
        result["action"], info = self._filter(transition["action"], transition.get("observation"))
        result["info"] = {**(transition.get("info") or {}), "guard": info}
        return result

    def transform_features(self, features: Any) -> Any:
        """Return the features unchanged, because an action keeps its shape."""
        return features

    def get_config(self) -> dict[str, Any]:
        """Return the configuration from which a pipeline recreates the step; a loaded guard is given by its path."""
        config: dict[str, Any] = {"positions": self.positions, "action_names": self.action_names}
        return config if self._path is None else {"guard": self._path, **config}

    def save_artifacts(self, save_directory: Path) -> dict[str, str]:
        """Save the guard beside the pipeline and return its file's name.

        LeRobot calls this from `save_pretrained`, and `from_pretrained` creates the step from that file.
        """
        with tempfile.TemporaryDirectory(dir=save_directory, prefix=".dfr-") as folder:
            path = Path(folder) / "guard"
            self.guard.save(path)
            name = f"guard_{hashlib.sha256(path.read_bytes()).hexdigest()[:12]}.guard"
            path.replace(Path(save_directory) / name)
        return {"guard": name}

    def state_dict(self) -> dict[str, Any]:
        """Return an empty dictionary: a guard is not a tensor, and `save_artifacts` saves it."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Do nothing: there are no tensors to load."""
