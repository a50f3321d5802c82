"""Experiments on your own plant in Python, with the engine of the programs."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import json
import linecache
import numbers
import pathlib
import secrets
import sys
from typing import Any, Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dfr import _core
from dfr._core import Guard
from dfr._pool import Pool
from dfr._unit import BASELINE, Episode, Unit

METHODS = (BASELINE, "monitor", "early-stopping", "dfr", "guard", "controller", "certified")


class Experiment:
    """Compares guarded and unguarded policies on your own plant, in processes and shards.

    Derive a class that defines the plant, the demonstrations and the learning of a policy. `main`
    then makes a program with the commands `experiment`, `merge`, `status`, `episodes` and `rerun`, which
    `dfr-cluster` runs on a Slurm cluster. Each trial has its own demonstrations. All methods start
    from the same states.

    Required members of a plant: `reset(seed)`; `step(action)`, after which the plant is at rest;
    `observe()`, which returns its state; `completed` and `collided` (attributes or methods), true if
    the task is done in the current state and if a constraint was violated since `reset`. For films,
    it may have `render()`, which returns an RGB picture of the current state as a (height,
    width, 3) array of uint8. A policy is a callable `policy(t, state)` that returns the action of
    time step t. If it has a method `reset(seed)`, that method starts an episode.

    Results are the same for any number of processes. One process with its own plant runs each unit
    (a trial, a data point and a learner), and all randomness follows from seeds. Code that draws from
    `random` or `numpy.random` is also covered: both are seeded before each call of `demonstrate`,
    `learn` and `guard` and before each episode.

    Attributes
    ----------
    name : str
        Name of the folder out/<name>; by default the class's name in lower case.
    methods : sequence of str
        The first is the reference. "baseline" is the unguarded policy; the others are strategies of a guard:
        "monitor", "early-stopping", "dfr", "guard", "controller", "certified".
    learners : sequence of str
        Kinds of policies, or of anything else that `learn` varies.
    demonstrations : sequence of int
        Data points (numbers of demonstrations), ascending.
    trials, episodes : int
        Number of independent repetitions, and of start states per repetition and data point.
    parameters : mapping of str to bool, int, float or str
        Your own parameters, with their defaults. Each is an option of the command line and a key of
        --config and of grids; `self.parameters["x"]` is the chosen value.
    start_method : str
        Start method of multiprocessing. "fork" does not require an importable program file; "spawn" is
        for libraries that do not support a fork.
    """

    name: str = ""
    methods: Sequence[str] = (BASELINE, "early-stopping", "dfr", "guard")
    learners: Sequence[str] = ("policy",)
    demonstrations: Sequence[int] = (60,)
    trials: int = 5
    episodes: int = 20
    parameters: Mapping[str, Any] = {}
    start_method: str = "fork"
    _kept: tuple[Any, list[Any]] = (None, [])
    _chosen: tuple[Any, dict[str, Any]] = (None, {})
    _defaults: dict[str, Any] = {}
    _file: str | None = None
    _hash: str = ""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls._file, cls._hash = _origin(cls)  # read now, because the file may be edited before a run

    def plant(self) -> Any:
        """Return a plant. Called once per unit, in the process that runs it."""
        raise NotImplementedError(f"{type(self).__name__} must define plant()")

    def demonstrate(self, seed: int) -> tuple[ArrayLike, ArrayLike]:
        """Return states (n + 1, state_dim) and actions (n, action_dim) of one demonstration."""
        raise NotImplementedError(f"{type(self).__name__} must define demonstrate(seed)")

    def learn(
        self, learner: str, states: list[NDArray[np.float64]], actions: list[NDArray[np.float64]], seed: int
    ) -> Callable[[int, NDArray[np.float64]], ArrayLike]:
        """Return a policy(t, state) learned from demonstrations."""
        raise NotImplementedError(f"{type(self).__name__} must define learn(learner, states, actions, seed)")

    def guard(self, states: list[NDArray[np.float64]], actions: list[NDArray[np.float64]]) -> Guard:
        """Return the guard of these demonstrations. Override this method to change features or options of the fit."""
        return Guard.fit(states, actions)

    def main(self) -> None:
        """Run the command line of this program; after an error, print it and exit with 1."""
        try:
            self.run()
        except (ImportError, RuntimeError, ValueError, OSError) as error:
            sys.exit(f"{self._program()}: {error}")
        except KeyboardInterrupt:
            sys.exit(130)

    def run(self, arguments: Sequence[str] | None = None) -> dict[str, Any] | None:
        """Run a command line.

        Parameters
        ----------
        arguments : sequence of str, optional
            For example ["experiment", "--out", "out", "--threads", "4"], where --threads is the number of
            processes; None: the arguments of this program.

        Returns
        -------
        dict or None
            The content of summary.json, which is next to the report in --out; None after `rerun`, and for a
            shard, which must be merged.

        Raises
        ------
        RuntimeError
            If a unit fails or the ledger has another setting; the message names the unit or the setting.
        ValueError
            If a method or parameter is invalid; the message names it.
        SystemExit
            After --help, wrong options, `status` and `episodes`.
        ImportError
            If this build of the module has no engine.
        """
        if not hasattr(_core, "run_experiment"):
            raise ImportError(
                "this build of dfr does not contain Experiment. Install libcli11-dev, libtomlplusplus-dev and "
                "nlohmann-json3-dev, and build it again."
            )
        plan, options = _plan(self), self._options()
        with contextlib.ExitStack() as stack:

            def begin(chosen: dict[str, Any], seed: int, methods: list[str], processes: int) -> tuple[Any, Any, Any]:
                self._choose(chosen)
                for method in methods:
                    _check(method)
                pool = stack.enter_context(Pool(self, seed, methods, processes))
                return self._settings(), pool.unit, pool.kill

            result = _core.run_experiment(
                sys.argv[1:] if arguments is None else [str(a) for a in arguments],
                self._name(),
                self._program(),
                (inspect.getdoc(type(self)) or self._name()).partition("\n")[0],
                plan,
                options,
                begin,
            )
        if isinstance(result, int):
            raise SystemExit(result)
        return None if result is None else dict(json.loads(result))

    def replay(self, folder: Any, episode: str, methods: Sequence[str] = ()) -> dict[str, Episode]:
        """Repeat an episode of an experiment, given its id from the command `episodes`.

        Parameters
        ----------
        folder : path_like
            Folder of the experiment.
        episode : str
            TRIAL/DEMONSTRATIONS/LEARNER/METHOD/START
        methods : sequence of str
            Additional methods, from the same start state.

        Returns
        -------
        dict of str to Episode
            The episode of each method. `dfr.plot.episode(episodes["guard"].infos)` plots an episode.

        Raises
        ------
        RuntimeError
            If the episode has other settings than this program or is from another version of dfr.
        """
        found = _core.find_episode(folder, episode)
        there, options = found["settings"], self._options()
        self._choose({key: _like(value, there[key]) if key in there else value for key, value in options.items()})
        there = {**there, "commit": found["commit"]}
        now = {**self._settings(), "commit": _core.build_commit}
        for key in sorted({*there, *now}):
            if now.get(key) != there.get(key):
                raise RuntimeError(
                    f"{folder}: this program cannot run its episodes again: {key} is {there.get(key)} there "
                    f"and {now.get(key)} now"
                )
        names = [*(m for m in methods if m != found["method"]), found["method"]]
        for name in names:
            _check(name)
        unit = Unit(self, found["seed"], names, found["trial"], found["demonstrations"], found["learner"])
        return {
            name: unit.episode(k, found["start_seed"], found["controller_seed"]) for k, name in enumerate(names)
        }

    def _name(self) -> str:
        return self.name or type(self).__name__.lower()

    def _program(self) -> str:
        return self._file or self._name()

    def _options(self) -> dict[str, Any]:
        """Return the options of the command line with their defaults: parameters of the class, or set since the last run."""
        if self.parameters is not self._chosen[0] or self.parameters != self._chosen[1]:
            self._defaults = {key: _plain(key, value) for key, value in self.parameters.items()}
        return {_option(key): value for key, value in self._defaults.items()}

    def _choose(self, chosen: Mapping[str, Any]) -> None:
        self.parameters = {key: chosen[_option(key)] for key in self._defaults}
        self._chosen = (self.parameters, dict(self.parameters))

    def _settings(self) -> dict[str, str]:
        """Return the settings beyond the plan that determine results; a ledger with other settings is refused."""
        settings = {_option(key): _core.setting_of(value) for key, value in self.parameters.items()}
        return {**settings, f"hash of {self._file or type(self).__name__}": self._hash}


def _origin(experiment: type) -> tuple[str | None, str]:
    """Return the name of the file that defines a class, and the hash of this file.

    In a notebook, these are None and a hash of the cells of its methods. Without any text, for example in a
    program from standard input, the hash is unique to the class object.
    """

    def hashed(content: bytes) -> str:
        return hashlib.sha256(content).hexdigest()[:16]

    with contextlib.suppress(TypeError, OSError):
        path = pathlib.Path(inspect.getsourcefile(experiment) or "")
        return path.name, hashed(path.read_bytes())
    texts = []
    for one in experiment.__mro__:
        if one.__module__ == experiment.__module__:
            methods = [inspect.unwrap(f) for f in vars(one).values() if inspect.isfunction(f)]
            cells = sorted({f.__code__.co_filename for f in methods})
            texts.append("".join(line for cell in cells for line in linecache.getlines(cell)))
    return None, hashed("\0".join(texts).encode()) if all(texts) else secrets.token_hex(8)


def _plan(experiment: Experiment) -> dict[str, Any]:
    """Check the experiment's plan, and return it."""

    def count(key: str, value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, numbers.Integral) or not 0 < value < 2**31:
            raise ValueError(f"{key} must be a whole number from 1 to {2**31 - 1}, not {value!r}")
        return int(value)

    plan: dict[str, Any] = {key: count(key, getattr(experiment, key)) for key in ("trials", "episodes")}
    several = getattr(experiment, "demonstrations")
    if isinstance(several, (str, numbers.Number)):
        raise ValueError(f"demonstrations must be a list of whole numbers, as in (20, 60), not {several!r}")
    plan["demonstrations"] = [count("each of demonstrations", value) for value in several]
    for key in ("methods", "learners"):
        names = getattr(experiment, key)
        if isinstance(names, str) or not all(isinstance(name, str) for name in names):
            raise ValueError(f"{key} must be a list of names, not {names!r}")
        plan[key] = list(names)
    return plan


def _plain(name: Any, value: Any) -> bool | int | float | str:
    """Check a parameter, and return its value as a type of Python, which all parts of the engine accept."""
    if not (isinstance(name, str) and name.isidentifier()):
        raise ValueError(f"parameters has {name!r}, which is not a valid option name: use letters, digits and _")
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, numbers.Integral):
        if not -(2**63) <= value < 2**63:
            raise ValueError(f"parameter {name} must fit into 64 bits, not {value!r}")
        return int(value)
    if isinstance(value, numbers.Real):
        return float(value)
    if not isinstance(value, str):
        raise ValueError(f"parameter {name} must be a number, text, True or False, not {value!r}")
    return value


def _option(parameter: str) -> str:
    return parameter.replace("_", "-")


def _like(default: Any, text: str) -> Any:
    """Convert a setting's text to the type of its parameter."""
    return text == "true" if isinstance(default, bool) else type(default)(text)


def _check(method: str) -> None:
    if method not in METHODS:
        raise ValueError(f"unknown method '{method}'; valid: {', '.join(METHODS)}")
