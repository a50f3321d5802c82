"""Processes that run the units of an experiment."""

from __future__ import annotations

import multiprocessing
import queue
import signal
import traceback
from typing import TYPE_CHECKING, Any

from dfr._unit import Unit

if TYPE_CHECKING:
    from dfr._experiment import Experiment


def _work(experiment: Experiment, seed: int, methods: list[str], connection: Any, others: list[Any]) -> None:
    """Run a worker process, which answers requests until the connection ends."""
    for other in others:  # a copy inherited by fork would keep the connection open
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
                unit = Unit(experiment, seed, methods, *arguments)
                answer = None
            else:
                answer = getattr(unit, what)(*arguments)
        except BaseException:  # any error of a plant: the engine reports it
            connection.send((False, traceback.format_exc()))
        else:
            connection.send((True, answer))


class Pool:
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

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *exception: object) -> None:
        for _, connection in self._workers:
            connection.close()
        for process, _ in self._workers:
            process.join(1.0)
        self.kill()  # a process may be running an episode whose result is not needed

    def kill(self) -> None:
        """End all processes at once; waiting units raise RuntimeError."""
        for process, _ in self._workers:
            process.kill()

    def unit(self, trial: int, demonstrations: int, learner: str) -> _Remote:
        return _Remote(self, trial, demonstrations, learner)


class _Remote:
    """A unit in a worker process, which no other unit uses until `close`."""

    def __init__(self, pool: Pool, trial: int, demonstrations: int, learner: str) -> None:
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
