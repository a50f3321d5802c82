"""Plots of a guard's decisions; requires matplotlib. Import it as `from dfr import plot`.

Every function draws on `ax` or, by default, on matplotlib's current axes, and returns the axes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Sequence

import numpy as np
from numpy.typing import ArrayLike

from dfr._core import Guard

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Colour-blind-safe colours, by the reason for the action. The page planar.html uses the same colours.
_COLOURS = {
    "inside": "#0072b2",
    "outside": "#56b4e9",
    "changed": "#009e73",
    "probe": "#e69f00",
    "demonstrations": "#cc79a7",
    "recovery": "#d55e00",
    "halt": "#22252a",
}


def _axes(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    from matplotlib import pyplot

    return pyplot.gca()


def episode(infos: Sequence[dict[str, Any]], *, ax: Axes | None = None) -> Axes:
    """Plot g over the actions of one episode, coloured by the guard's decision.

    A dashed line is the threshold at which the policy's action passes, if the guard's strategy has
    one. Red marks at the bottom are alarms.

    Parameters
    ----------
    infos : sequence of dict
        The infos of `Guard.filter`, one per action; `GuardedEnv` and `GuardStep` return them as
        `info["guard"]`.

    Raises
    ------
    ValueError
        If `infos` is empty.
    """
    if len(infos) == 0:
        raise ValueError("infos is empty: pass the infos that Guard.filter returned in an episode")
    ax = _axes(ax)
    g = np.array([info["g"] for info in infos], dtype=float)
    threshold = np.array([info["threshold"] for info in infos], dtype=float)
    # In a halt, `reason` is one of many causes, which share one colour.
    kinds = [info["mode"] if info["mode"] == "halt" else info["reason"] for info in infos]
    ax.axhline(0.0, color="0.5", linewidth=0.8)
    ax.plot(g, color="0.75", linewidth=1.0, zorder=1)
    for kind, colour in _COLOURS.items():
        at = [t for t, k in enumerate(kinds) if k == kind]
        if at:
            ax.scatter(at, g[at], s=14, color=colour, label=kind, zorder=2)
    if np.isfinite(threshold).any():
        ax.plot(threshold, color="0.4", linewidth=1.0, linestyle="--", label="threshold")
    alarms = [t for t, info in enumerate(infos) if info["alarm"]]
    if alarms:
        low = ax.get_ylim()[0]
        ax.scatter(alarms, np.full(len(alarms), low), s=30, marker="|", color="#cc3344", label="alarm")
    ax.set_xlabel("action")
    ax.set_ylabel("g, positive inside")
    ax.legend(fontsize="small", frameon=False)
    return ax


def levels(guard: Guard, demonstrations: Sequence[ArrayLike], *, ax: Axes | None = None) -> Axes:
    """Plot l over the states of each demonstration; l is positive inside the support.

    The band between 0 and the dotted line is outside the support but below the alarm. Nearly all
    demonstrations that the guard was fitted to should be above 0. Demonstrations that were left
    out of the fit are a stronger test.

    Parameters
    ----------
    demonstrations : sequence of array_like, (T + 1, guard.state_dim) each
        States, as in `Guard.fit`.
    """
    ax = _axes(ax)
    for states in demonstrations:
        l = guard.levels(states)
        raises = bool(np.min(l) < -guard.settings["alarm_level"])
        ax.plot(l, color="#cc3344" if raises else "#26786e", linewidth=0.8, alpha=0.9 if raises else 0.4)
    ax.axhline(0.0, color="0.3", linewidth=1.0)
    ax.axhline(-guard.settings["alarm_level"], color="0.3", linewidth=1.0, linestyle=":")
    ax.set_xlabel("state")
    ax.set_ylabel("l, positive inside")
    return ax


def features(guard: Guard, episodes: Sequence[ArrayLike], *, most: int = 12, ax: Axes | None = None) -> Axes:
    """Plot the contribution of each state entry to -l, averaged over the states outside the support.

    One bar per entry, the largest on top. Entries that no feature uses have no bar.

    Parameters
    ----------
    episodes : sequence of array_like, (T + 1, guard.state_dim) each
        States of episodes that leave the support.
    most : int
        Maximum number of entries.

    Raises
    ------
    ValueError
        If all states are inside, or immeasurably far outside: there is nothing to attribute.
    """
    rows = [guard.attribution(states) for states in episodes]
    # A row is NaN if its state is immeasurably far outside.
    outside = [row for attribution in rows for row in attribution if row.any() and np.isfinite(row).all()]
    if not outside:
        raise ValueError("all states are inside or immeasurably far outside: pass episodes that leave the support, "
                         "recorded with strategy 'monitor' for example")
    mean = np.mean(outside, axis=0)
    names = [name if size == 1 else f"{name}[{k}]" for name, size in guard.layout for k in range(int(np.prod(size)))]
    chosen = [k for k in np.argsort(-np.abs(mean), kind="stable")[:most] if mean[k] != 0.0][::-1]
    ax = _axes(ax)
    ax.barh([names[k] for k in chosen], mean[chosen], color="#26786e")
    ax.axvline(0.0, color="0.3", linewidth=1.0)
    ax.set_xlabel(f"part of -l, mean over {len(outside)} states outside")
    return ax
