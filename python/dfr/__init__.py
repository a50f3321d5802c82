"""Safe execution of policies learned from demonstrations.

`TimeVaryingSupport` estimates which states were demonstrated at each time step, `OneClassSVM` does so
for any cloud of samples with scikit-learn's interface. Both fit and decide in C++, without holding
the interpreter's lock. `Guard` keeps what any policy does inside what was demonstrated, and
`GuardedEnv` puts it around an environment. `load_demonstrations` reads robomimic's, Minari's and
LeRobot's files. `Experiment` compares methods on a plant of your own, in processes and shards.
"""

from dfr._core import FitSummary, Guard, SupportEstimate, TimeVaryingSupport, __version__
from dfr._demonstrations import Demonstrations, load_demonstrations
from dfr._experiment import Episode, Experiment
from dfr._guard_step import GuardStep
from dfr._guarded_env import GuardedEnv
from dfr._one_class_svm import OneClassSVM

__all__ = [
    "Demonstrations",
    "Episode",
    "Experiment",
    "FitSummary",
    "Guard",
    "GuardStep",
    "GuardedEnv",
    "OneClassSVM",
    "SupportEstimate",
    "TimeVaryingSupport",
    "__version__",
    "load_demonstrations",
]

for _public in (FitSummary, Guard, SupportEstimate, TimeVaryingSupport):
    _public.__module__ = "dfr"
del _public
