"""Functions for pickles, which cannot name functions of the compiled module."""

from __future__ import annotations

from typing import Any


def restore(cls: Any, state: Any) -> Any:
    """Restore an object of a compiled class from its pickled state."""
    return cls._from_state(state)
