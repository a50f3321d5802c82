"""Experiments on your own plant in Python, with the engine of the programs."""

from __future__ import annotations

import contextlib
import inspect
import json
import multiprocessing
import pathlib
import queue
import random
import signal
import struct
import sys
import time
import traceback
import zlib
from typing import TYPE_CHECKING, Any, Callable, Mapping, NamedTuple, Sequence, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dfr import _core
from dfr._core import Guard

if TYPE_CHECKING:
    from dfr._core import GuardInfo, Strategy

BASELINE = "baseline"
METHODS = (BASELINE, "monitor", "early-stopping", "dfr", "guard", "controller", "certified")

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


class Experiment:
    """Compares guarded and unguarded policies on your own plant, in processes and shards.

    Derive a class that defines the plant, the demonstrations and the learning of a policy. `main`
    then makes a program with the commands `experiment`, `merge`, `status` and `episodes`, which
    `dfr-cluster` runs on a Slurm cluster. Each trial has its own demonstrations. All methods start
    from the same states.

    Required members of a plant: `reset(seed)`; `step(action)`, after which the plant is at rest;
    `observe()`, which returns its state; `completed` and `collided` (attributes or methods), whether
    the task is done in the current state and whether a constraint was violated since `reset`. For
    films, it may have `render()`, which returns an RGB picture of the current state as a (height,
    width, 3) array of uint8. A policy is a callable `policy(t, state)` that returns the action of
    time step t. If it has a method `reset(seed)`, that method starts an episode.

    Results are the same for any number of processes. One process with its own plant runs each unit
    (a trial, a data point and a learner), and all randomness follows from seeds. Code that draws from
    `random` or `numpy.random` is covered, too: both are seeded before each call of `demonstrate`,
    `learn` and `guard` and before each episode.

    Attributes
    ----------
    name : str
        Name of the folder out/<name>; by default the class's name in lower case.
    methods : sequence of str
        The first is the reference. "baseline" is the unguarded policy, the others are strategies of a guard:
        "monitor", "early-stopping", "dfr", "guard", "controller", "certified".
    learners : sequence of str
        Kinds of policies, or of anything else that `learn` varies.
    demonstrations : sequence of int
        Data points (numbers of demonstrations), ascending.
    trials, episodes : int
        Number of independent repetitions, and of start states in each.
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
        """Return the guard of these demonstrations; override it to change features or options of the fit."""
        return Guard.fit(states, actions)

    def main(self) -> None:
        """Run the command line of this program; prints errors and exits with 1."""
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
            The content of summary.json, which is next to the report in --out; None for a shard, which must
            be merged.

        Raises
        ------
        RuntimeError
            With the unit and the error of its process, or the first setting that differs from the ledger's.
        ValueError
            With the unknown method or parameter.
        SystemExit
            After --help, wrong options, `status` and `episodes`.
        ImportError
            If this build of the module has no engine.
        """
        if not hasattr(_core, "run_experiment"):
            raise ImportError(
                "this build of dfr has no Experiment. Install libcli11-dev, libtomlplusplus-dev and "
                "nlohmann-json3-dev, and build it again."
            )
        defaults = {
            key: getattr(self, key) for key in ("methods", "learners", "demonstrations", "trials", "episodes")
        }
        options = {_option(key): value for key, value in type(self).parameters.items()}
        with contextlib.ExitStack() as stack:

            def begin(chosen: dict[str, Any], seed: int, methods: list[str], processes: int) -> tuple[Any, Any]:
                self._choose(chosen)
                for method in methods:
                    _check(method)
                pool = stack.enter_context(_Pool(self, seed, methods, processes))
                return self._settings(), pool.unit

            result = _core.run_experiment(
                sys.argv[1:] if arguments is None else [str(a) for a in arguments],
                self._name(),
                self._program(),
                (inspect.getdoc(type(self)) or self._name()).partition("\n")[0],
                defaults,
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
            `dfr.plot.episode(found["guard"].infos)` plots one.

        Raises
        ------
        RuntimeError
            If the episode has other settings than this program or is from another version of dfr.
        """
        found = _core.find_episode(folder, episode)
        options = {_option(key): value for key, value in type(self).parameters.items()}
        there = found["settings"]
        self._choose({key: _like(value, there[key]) if key in there else value for key, value in options.items()})
        there = {**there, "commit": found["commit"]}
        now = {**self._settings(), "commit": _core.build_commit}
        for key in sorted({*there, *now}):
            if now.get(key) != there.get(key):
                raise RuntimeError(
                    f"{folder}: its episodes cannot be run again by this program: {key} is {there.get(key)} there "
                    f"and {now.get(key)} now"
                )
        names = [*(m for m in methods if m != found["method"]), found["method"]]
        for name in names:
            _check(name)
        unit = _Unit(self, found["seed"], names, found["trial"], found["demonstrations"], found["learner"])
        return {
            name: unit.episode(k, found["start_seed"], found["controller_seed"]) for k, name in enumerate(names)
        }

    def _name(self) -> str:
        return self.name or type(self).__name__.lower()

    def _source(self) -> str | None:
        with contextlib.suppress(TypeError, OSError):
            return inspect.getsourcefile(type(self))
        return None

    def _program(self) -> str:
        source = self._source()
        return pathlib.Path(source).name if source else self._name()

    def _choose(self, chosen: Mapping[str, Any]) -> None:
        self.parameters = {key: chosen[_option(key)] for key in type(self).parameters}

    def _settings(self) -> dict[str, str]:
        """Return the settings, other than the plan, that determine the results; a ledger with others is refused."""
        settings = {_option(key): _core.setting_of(value) for key, value in self.parameters.items()}
        source = self._source()
        if source:
            settings["hash of " + pathlib.Path(source).name] = _core.hash_of_file(source)
        return settings


def _option(parameter: str) -> str:
    return parameter.replace("_", "-")


def _like(default: Any, text: str) -> Any:
    """Convert a setting's text to the type of its parameter."""
    return text == "true" if isinstance(default, bool) else type(default)(text)


def _check(method: str) -> None:
    if method not in METHODS:
        raise ValueError(f"unknown method '{method}'; valid: {', '.join(METHODS)}")


def _says(value: Any) -> bool:
    return bool(value() if callable(value) else value)


def _seed(seed: int) -> None:
    """Seed the interpreter's and NumPy's generators, for code that draws from them."""
    random.seed(seed)
    np.random.seed(seed % 2**32)


def _recovers(episode: Episode) -> list[bool]:
    """Return, for each action, whether a recovery chose it; always False for the baseline."""
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
    """Return pictures side by side as an animated PNG, 15 a second; shorter films hold their last picture."""
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


class _Unit:
    """A learned unit and everything that its episodes need."""

    def __init__(
        self, experiment: Experiment, seed: int, methods: Sequence[str], trial: int, demonstrations: int, learner: str
    ) -> None:
        states, actions = _demonstrations(experiment, seed, trial, demonstrations)
        learning = _core.derive_seed(seed, _LEARNING, trial, 0)
        _seed(learning)
        self.policy = experiment.learn(learner, states, actions, learning)
        _seed(learning)
        guard = experiment.guard(states, actions)
        self.support = guard
        # A method that is no strategy is refused by name.
        strategies = cast("list[Strategy]", methods)
        self.guards = [None if m == BASELINE else guard.with_settings(strategy=m) for m in strategies]
        self.plant = experiment.plant()

    def _observe(self) -> NDArray[np.float64]:
        return np.array(self.plant.observe(), dtype=np.float64).ravel()

    def accepts(self, start_seed: int) -> bool:
        """Return whether the start state is inside the support: no action could correct one outside."""
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
        """Return, per method, the result of `run`, the states and the recovery flags; and an animation.

        The animation is empty if the plant has no pictures, which is an error if `pictures` is set.
        """
        renders = hasattr(self.plant, "render")
        if pictures and not renders:
            raise ValueError(
                "the plant has no pictures: give its class a method render() that returns an RGB array "
                "(height, width, 3) of uint8, or take --film FILE.html, a page of the states"
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
        """Run one episode; appends the plant's picture of each state to `frames`."""
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
            action = np.array(self.policy(t, states[-1]), dtype=np.float64).ravel()
            if guard is not None:
                action, info = guard.filter(t, states[-1], action)
                infos.append(info)
                if info["mode"] == "halt":
                    cause = info["reason"]
                    break
                chooser = info["reason"] if info["changed"] or info["mode"] != "policy" else "policy"
            self.plant.step(action)
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
    """Return the first `count` demonstrations of a trial; caches those of the latest trial."""
    key = (tuple(experiment.parameters.items()), seed, trial)
    if experiment._kept[0] != key:
        experiment._kept = (key, [])
    kept = experiment._kept[1]
    while len(kept) < count:
        one = _core.derive_seed(seed, _DEMONSTRATIONS, trial, len(kept))
        _seed(one)
        states, actions = experiment.demonstrate(one)
        kept.append((np.array(states, dtype=np.float64), np.array(actions, dtype=np.float64)))
    return [states for states, _ in kept[:count]], [actions for _, actions in kept[:count]]


def _work(experiment: Experiment, seed: int, methods: list[str], connection: Any, others: list[Any]) -> None:
    """Run a worker process: answers requests until the connection ends."""
    for other in others:  # copies due to fork, which would keep them open
        other.close()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1):  # schedulers send these to all processes
        signal.signal(number, signal.SIG_IGN)
    unit: Any = None
    while True:
        try:
            what, *arguments = connection.recv()
        except EOFError:
            return
        try:
            if what == "begin":
                unit = None
                unit = _Unit(experiment, seed, methods, *arguments)
                answer = None
            else:
                answer = getattr(unit, what)(*arguments)
        except BaseException:  # any error of a plant: the engine reports it
            connection.send((False, traceback.format_exc()))
        else:
            connection.send((True, answer))


class _Pool:
    """Worker processes, started before the engine has threads."""

    def __init__(self, experiment: Experiment, seed: int, methods: list[str], count: int) -> None:
        context = multiprocessing.get_context(experiment.start_method)
        forks = experiment.start_method == "fork"
        self._workers: list[tuple[Any, Any]] = []
        self.idle: queue.Queue[tuple[Any, Any]] = queue.Queue()
        for _ in range(count):
            ours, theirs = context.Pipe()
            others = [ours, *(connection for _, connection in self._workers)] if forks else []
            process = context.Process(target=_work, args=(experiment, seed, methods, theirs, others), daemon=True)
            process.start()
            theirs.close()
            self._workers.append((process, ours))
            self.idle.put((process, ours))

    def __enter__(self) -> _Pool:
        return self

    def __exit__(self, *exception: object) -> None:
        for _, connection in self._workers:
            connection.close()
        for process, _ in self._workers:
            process.join(1.0)
            process.kill()  # may be in an episode whose result is not needed

    def unit(self, trial: int, demonstrations: int, learner: str) -> _Remote:
        return _Remote(self, trial, demonstrations, learner)


class _Remote:
    """A unit in a worker process, reserved for it until `close`."""

    def __init__(self, pool: _Pool, trial: int, demonstrations: int, learner: str) -> None:
        self._label = f"trial {trial}, {demonstrations} demonstrations, {learner}"
        self._idle = pool.idle
        self._worker = pool.idle.get()
        self._ask("begin", trial, demonstrations, learner)

    def _ask(self, *message: Any) -> Any:
        process, connection = self._worker
        try:
            connection.send(message)
            done, answer = connection.recv()
        except (EOFError, OSError):
            process.join(1.0)
            raise RuntimeError(
                f"{self._label}: its process ended with exit code {process.exitcode}; finished units are kept, "
                "and the same command resumes from there"
            ) from None
        if not done:
            raise RuntimeError(f"{self._label}: {answer}")
        return answer

    def accepts(self, start_seed: int) -> bool:
        return bool(self._ask("accepts", start_seed))

    def run(self, method: int, start_seed: int, controller_seed: int) -> Any:
        return self._ask("run", method, start_seed, controller_seed)

    def film(self, methods: list[int], start_seed: int, controller_seed: int, pictures: bool) -> Any:
        return self._ask("film", methods, start_seed, controller_seed, pictures)

    def close(self) -> None:
        self._idle.put(self._worker)
