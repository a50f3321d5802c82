"""What pickles call: the functions of the compiled module cannot be pickled by name."""

from __future__ import annotations

from typing import Any


def restore(cls: Any, state: Any) -> Any:
    """The object of a compiled class of which this was pickled."""
    return cls._from_state(state)
