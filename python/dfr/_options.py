"""Error messages for keywords that a function of the compiled module does not accept."""

from __future__ import annotations

import difflib
import functools
import re
from typing import Any, Callable


def names_of(function: Callable[..., Any]) -> list[str]:
    """Return the parameters of a compiled function, from the first line of its documentation."""
    signature = (function.__doc__ or "").split("->", 1)[0]
    return [name for name in re.findall(r"[(,] *(\w+):", signature) if name != "self"]


def named_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap `function`: its error for an unknown keyword names the keyword and the closest valid one."""
    known = names_of(function)

    @functools.wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        for name in options:
            if name not in known:
                close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
                hint = f": did you mean '{close[0]}'?" if close else f"; it has {', '.join(known)}"
                raise TypeError(f"{function.__name__}() has no parameter '{name}'{hint}")
        return function(*args, **options)

    return call
