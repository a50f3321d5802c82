"""Demonstration files as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dfr import _core


class Demonstrations(NamedTuple):
    """Content of a demonstration file, for `dfr.Guard.fit(d.states, d.actions, layout=d.layout)`."""

    states: list[NDArray[np.float64]]
    """One array (n_actions + 1, state_dim) per episode, including the state after the last action."""
    actions: list[NDArray[np.float64]]
    """One array (n_actions, action_dim) per episode."""
    layout: list[tuple[str, int | tuple[int, int, int]]]
    """Name and size of each part of a state; a picture's size is (height, width, channels)."""
    completed: list[bool]
    """True for each episode that completed its task; False if the file does not record it."""
    environment: str
    """Name of the environment, task or robot."""
    note: str
    """Skipped content, for example images, videos and episodes; empty if there is none."""

    def __repr__(self) -> str:
        widths = [arrays[0].shape[1] if arrays else 0 for arrays in (self.states, self.actions)]
        return (
            f"<dfr.Demonstrations: {len(self.actions)} episodes, {sum(map(len, self.actions))} actions, "
            f"states of {widths[0]} entries, actions of {widths[1]}, {self.environment!r}>"
        )


def load_demonstrations(
    path: str | PathLike[str], *, filter_key: str = "", pictures: str | Sequence[str] = (), all: bool = False
) -> Demonstrations:
    """Read demonstrations of robomimic (HDF5), Minari or LeRobot, and detect the format.

    Episodes that did not complete the task are left out, as `guard fit` does, unless no episode is recorded as
    completed. `note` gives their number.

    Parameters
    ----------
    path : path_like
        A robomimic file, or the folder of a Minari or LeRobot dataset.
    filter_key : str
        Reads only the episodes under this key: a mask of a robomimic file or a split of LeRobot.
    pictures : str or sequence of str
        Names of datasets of pictures (HDF5) or videos (LeRobot) to read as parts of the states; others
        are skipped. A video's frames are averaged to 32 pixels along the longer side;
        "observation.images.top:24x32" averages them to 24 rows of 32 pixels.
    all : bool
        Includes episodes that did not complete the task.

    Returns
    -------
    Demonstrations

    Raises
    ------
    FileNotFoundError
        If there is no such file or folder.
    RuntimeError
        If reading fails; the message names file, episode, dataset or column, and the problem.
    ImportError
        If this build of the module cannot read such files.
    """
    if isinstance(pictures, str):
        pictures = (pictures,)
    if not hasattr(_core, "load_demonstrations"):
        raise ImportError(
            "this build of dfr cannot read demonstrations. Install libhdf5-dev, libsnappy-dev, libzstd-dev and "
            "nlohmann-json3-dev and build it again, or read the file with h5py and pass arrays to dfr.Guard.fit."
        )
    read = Demonstrations(*_core.load_demonstrations(path, filter_key, list(pictures)))
    kept = [i for i, completed in enumerate(read.completed) if completed]
    if all or len(kept) == len(read.completed):
        return read
    if kept:
        said = f"{len(read.completed) - len(kept)} episodes did not complete the task and are left out (all=True takes them)"
        read = read._replace(**{key: [getattr(read, key)[i] for i in kept] for key in ("states", "actions", "completed")})
    else:
        said = f"none of {len(read.completed)} episodes is recorded as completed: if they failed, use others"
    return read._replace(note="\n".join(filter(None, (read.note, said))))
