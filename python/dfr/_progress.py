"""Progress of a long fit, printed to a terminal or notebook."""

from __future__ import annotations

import functools
import multiprocessing
import sys
import time
from typing import Any, Callable


def is_read() -> bool:
    """Return True if standard error is a terminal or the cell of a notebook, and this is not a worker process."""
    if multiprocessing.parent_process() is not None:
        return False
    stream = sys.stderr
    notebook = "ipykernel" in sys.modules and type(stream).__module__.startswith("ipykernel")
    return notebook or bool(getattr(stream, "isatty", lambda: False)())


class Display:
    """Prints stage and completed share on one line of standard error, after the first two seconds of a fit."""

    AFTER, EVERY = 2.0, 0.2  # seconds

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._begun = clock()
        self._next = self._begun + self.AFTER
        self._width = 0

    def __call__(self, stage: str, share: float) -> None:
        now = self._clock()
        if now < self._next:
            return
        self._next = now + self.EVERY
        line = f"dfr: {stage}, {100 * share:.0f} %, {now - self._begun:.0f} s"
        print("\r" + line.ljust(self._width), end="", file=sys.stderr, flush=True)
        self._width = len(line)

    def close(self) -> None:
        """Clear the line."""
        if self._width:
            print("\r" + " " * self._width + "\r", end="", file=sys.stderr, flush=True)


def shows_progress(fit: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap `fit` to display its progress if `progress` is True, or if it is None and is_read() returns True."""

    @functools.wraps(fit)
    def call(*args: Any, progress: Callable[[str, float], object] | bool | None = None, **options: Any) -> Any:
        if progress is True or progress is None and is_read():
            display = Display()
            try:
                return fit(*args, progress=display, **options)
            finally:
                display.close()
        if progress is not None and progress is not False and not callable(progress):
            raise TypeError(f"progress must be True, False, None or a function of (stage, share), not {progress!r}")
        return fit(*args, progress=None if progress is False else progress, **options)

    return call
