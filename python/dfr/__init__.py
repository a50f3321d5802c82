"""Run-time safety filter for policies learned from demonstrations.

`TimeVaryingSupport` estimates the support of the demonstrated states at each time step.
`OneClassSVM` estimates the support of any sample cloud, with scikit-learn's interface. Both fit and
evaluate in C++ without holding the interpreter's lock. `Guard` is a run-time safety filter: it keeps
any policy inside the demonstrated states. `GuardedEnv` wraps an environment in a guard, and
`dfr.lerobot.GuardStep` is a step of LeRobot's pipelines.
`load_demonstrations` reads files of robomimic, Minari and LeRobot. `Experiment` compares methods on
your own plant, in processes and shards.
"""

from typing import TYPE_CHECKING, Any

from dfr._core import FitSummary, Guard, SupportEstimate, TimeVaryingSupport, __version__
from dfr._demonstrations import Demonstrations, load_demonstrations
from dfr._experiment import Episode, Experiment
from dfr._guarded_env import GuardedEnv
from dfr._one_class_svm import OneClassSVM
from dfr._options import named_options as _named
from dfr._progress import shows_progress as _shows

if TYPE_CHECKING:
    from dfr import lerobot, plot
else:

    def __getattr__(name: str) -> Any:
        """Import a module that needs other packages, on first use."""
        if name in ("lerobot", "plot"):
            import importlib

            return importlib.import_module(f"dfr.{name}")
        raise AttributeError(f"module 'dfr' has no attribute {name!r}")


__all__ = [
    "Demonstrations",
    "Episode",
    "Experiment",
    "FitSummary",
    "Guard",
    "GuardedEnv",
    "OneClassSVM",
    "SupportEstimate",
    "TimeVaryingSupport",
    "__version__",
    "load_demonstrations",
]

for _public in (FitSummary, Guard, SupportEstimate, TimeVaryingSupport):
    _public.__module__ = "dfr"
for _class, _names in ((Guard, ("fit", "load", "with_settings")), (TimeVaryingSupport, ("fit", "load"))):
    for _name in _names:
        _function = _named(getattr(_class, _name))
        setattr(_class, _name, _function if _name == "with_settings" else staticmethod(_function))
Guard.fit = staticmethod(_shows(Guard.fit))  # type: ignore[assignment]
del _class, _function, _name, _names, _named, _public, _shows
