from collections.abc import Callable, Iterable, Sequence
from os import PathLike
from typing import Any, Literal, TypedDict, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str
build_commit: str

Size = int | tuple[int, int] | tuple[int, int, int]
Layout = Sequence[tuple[str, Size]] | dict[str, Size]
Strategy = Literal["guard", "controller", "dfr", "early-stopping", "monitor", "certified"]

class GuardInfo(TypedDict):
    """Decision of Guard.filter."""

    g: float | None
    threshold: float | None
    mode: Literal["policy", "probe", "recovery", "halt"]
    reason: str
    source: Literal["policy", "policy-changed", "demonstrations", "probe", "recovery", "halt"]
    why: str
    changed: bool
    change: float | None
    certified: bool
    alarm: bool
    alarm_step: int
    entry: str | None
    step: int

class OutsideEntry(TypedDict):
    """An entry of a state that contributes to its distance from the support."""

    name: str
    entry: int
    excess: float
    share: float

class NearestDemonstration(TypedDict):
    """The demonstrated state nearest to a state."""

    demonstration: int
    step: int
    distance: float

class StateExplanation(TypedDict):
    """Result of Guard.explain."""

    text: str
    l: float
    step: int
    entries: list[OutsideEntry]
    nearest: NearestDemonstration | None

class FitSummary:
    @property
    def reason(self) -> str: ...
    @property
    def iterations(self) -> int: ...
    @property
    def kkt_gap(self) -> float: ...
    @property
    def objective(self) -> float: ...
    @property
    def kernel_evaluations(self) -> int: ...
    @property
    def seconds(self) -> float: ...
    @property
    def alpha(self) -> NDArray[np.float64]: ...

class SupportEstimate:
    @staticmethod
    def fit(
        samples: ArrayLike,
        *,
        nu: float = 0.05,
        gamma: float = 5.0,
        tolerance: float = 1e-4,
        max_iterations: int = 0,
        memory_mib: float = 512.0,
        weights: ArrayLike | None = None,
        threads: int = 0,
    ) -> tuple[SupportEstimate, FitSummary]: ...
    def decision(self, x: ArrayLike, *, libsvm_scale: bool = False) -> float | NDArray[np.float64]: ...
    def export_onnx(self, path: str | PathLike[str], *, libsvm_scale: bool = False) -> None: ...
    def gradient(self, x: ArrayLike) -> tuple[float, NDArray[np.float64]]: ...
    @property
    def state_dim(self) -> int: ...
    @property
    def gamma(self) -> float: ...
    @property
    def rho(self) -> float: ...
    @property
    def libsvm_scale(self) -> float: ...
    @property
    def lipschitz_bound(self) -> float: ...
    @property
    def alpha(self) -> NDArray[np.float64]: ...
    @property
    def support_vectors(self) -> NDArray[np.float64]: ...

class TimeVaryingSupport:
    def __init__(self, estimates: Sequence[SupportEstimate]) -> None: ...
    @staticmethod
    def fit(
        demonstrations: Iterable[ArrayLike],
        *,
        nu: float = 0.05,
        gamma: float = 5.0,
        tolerance: float = 1e-4,
        num_steps: int = 0,
        pooled: bool = False,
        threads: int = 0,
        weights: ArrayLike | None = None,
    ) -> TimeVaryingSupport: ...
    @staticmethod
    def load(path: str | PathLike[str]) -> TimeVaryingSupport: ...
    def save(self, path: str | PathLike[str]) -> None: ...
    @overload
    def decision(self, t: int, x: ArrayLike) -> float | NDArray[np.float64]: ...
    @overload
    def decision(self, t: ArrayLike, x: ArrayLike) -> NDArray[np.float64]: ...
    def export_onnx(self, path: str | PathLike[str]) -> None: ...
    def gradient(self, t: int, x: ArrayLike) -> tuple[float, NDArray[np.float64]]: ...
    def at(self, t: int) -> SupportEstimate: ...
    def lipschitz_bound(self, t: int) -> float: ...
    @property
    def state_dim(self) -> int: ...
    @property
    def num_steps(self) -> int: ...

class Guard:
    @staticmethod
    def fit(
        states: Iterable[ArrayLike],
        actions: Iterable[ArrayLike],
        *,
        layout: Layout = ...,
        features: str | Sequence[str] = "",
        nu: float = 0.05,
        gamma: float = 0.25,
        strategy: Strategy = "guard",
        horizon: int = 0,
        action_limit: float | Sequence[float] = 0.0,
        false_alarms: float = 0.1,
        confidence: float = 0.0,
        hold_out: float = 0.0,
        error_factor: float = 2.0,
        source: str = "",
        differences: bool = False,
        as_recorded: bool = False,
        accept_any: bool = False,
        progress: Callable[[str, float], object] | bool | None = None,
    ) -> Guard: ...
    @staticmethod
    def load(path: str | PathLike[str]) -> Guard: ...
    def save(self, path: str | PathLike[str]) -> None: ...
    def export_onnx(self, path: str | PathLike[str]) -> None: ...
    def reset(self, seed: int | None = 0) -> None: ...
    def stop(self) -> None: ...
    def filter(self, t: int, state: ArrayLike, action: ArrayLike) -> tuple[NDArray[np.float64], GuardInfo]: ...
    def applied(self, action: ArrayLike) -> None: ...
    def filter_chunk(self, t: int, state: ArrayLike, actions: ArrayLike) -> int: ...
    def explain(
        self, state: ArrayLike, *, t: int | None = None, demonstrations: Iterable[ArrayLike] = ()
    ) -> StateExplanation: ...
    @overload
    def decision(self, t: int, x: ArrayLike) -> float | NDArray[np.float64]: ...
    @overload
    def decision(self, t: ArrayLike, x: ArrayLike) -> NDArray[np.float64]: ...
    def certify(self, t: int, state: ArrayLike, action: ArrayLike) -> dict[str, Any]: ...
    def levels(self, states: ArrayLike) -> NDArray[np.float64]: ...
    def attribution(self, states: ArrayLike) -> NDArray[np.float64]: ...
    def reconstruct(self, block: str, state: ArrayLike) -> NDArray[np.float64]: ...
    def with_settings(
        self,
        *,
        strategy: Strategy | None = None,
        horizon: int | None = None,
        max_actions: int | None = None,
        action_limit: float | Sequence[float] | None = None,
        alarm_level: float | None = None,
        direction_error: float | None = None,
        demonstrated: bool | None = None,
    ) -> Guard: ...
    @property
    def state_dim(self) -> int: ...
    @property
    def action_dim(self) -> int: ...
    @property
    def num_steps(self) -> int: ...
    @property
    def layout(self) -> list[tuple[str, Size]]: ...
    @property
    def features(self) -> str: ...
    @property
    def periods(self) -> NDArray[np.float64]: ...
    @property
    def settings(self) -> dict[str, Any]: ...
    @property
    def summary(self) -> dict[str, Any]: ...

def load_demonstrations(
    path: str | PathLike[str], filter_key: str, pictures: list[str]
) -> tuple[list[Any], list[Any], list[Any], list[bool], str, str]: ...
def find_non_finite(x: ArrayLike) -> tuple[int, int] | None: ...
def variance(x: ArrayLike) -> float: ...
def run_experiment(
    arguments: Sequence[str],
    name: str,
    program: str,
    title: str,
    defaults: dict[str, Any],
    parameters: dict[str, Any],
    begin: Callable[
        [dict[str, Any], int, list[str], int], tuple[dict[str, str], Callable[[int, int, str], Any], Callable[[], None]]
    ],
) -> int | str | None: ...
def find_episode(folder: str | PathLike[str], name: str) -> dict[str, Any]: ...
def derive_seed(seed: int, stream: int, trial: int, index: int) -> int: ...
def setting_of(value: bool | int | float | str) -> str: ...
