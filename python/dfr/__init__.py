"""Safe execution of policies learned from demonstrations.

`TimeVaryingSupport` estimates which states were demonstrated at each time step, `OneClassSVM` does so
for any cloud of samples with scikit-learn's interface. Both fit and decide in C++, without holding
the interpreter's lock.
"""

from dfr._core import FitSummary, SupportEstimate, TimeVaryingSupport, __version__
from dfr._one_class_svm import OneClassSVM

__all__ = ["FitSummary", "OneClassSVM", "SupportEstimate", "TimeVaryingSupport", "__version__"]

for _public in (FitSummary, SupportEstimate, TimeVaryingSupport):
    _public.__module__ = "dfr"
del _public
