"""A one-class SVM with scikit-learn's interface."""

from __future__ import annotations

import warnings
from numbers import Integral, Real
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dfr import _core
from dfr._validation import (
    BaseEstimator,
    ConvergenceWarning,
    NotFittedError,
    OutlierMixin,
    check_rows,
    check_weights,
    store_features,
)

# The tolerance of a fit of up to _SMALL samples is at most _ROUNDING times the sum of the coefficients.
_SMALL = 256
_ROUNDING = 1e-13


class OneClassSVM(OutlierMixin, BaseEstimator):
    """Estimate the support of a distribution, with scikit-learn's interface.

    A faster drop-in replacement for `sklearn.svm.OneClassSVM` with the Gaussian kernel: the same
    parameters, attributes and decision values. Works with or without scikit-learn; if scikit-learn is
    installed, this class is one of its estimators.

    Parameters
    ----------
    kernel : {"rbf"}, default="rbf"
        The Gaussian kernel exp(-gamma |x - y|^2), the only supported one.
    degree : int, default=3
        Not used; for polynomial kernels.
    gamma : {"scale", "auto"} or float, default="scale"
        "scale" is 1 / (n_features * X.var()), "auto" 1 / n_features; a number must be positive.
    coef0 : float, default=0.0
        Not used; for other kernels.
    tol : float, default=1e-3
        Stop when the largest violation of the optimality conditions is below `tol`, as in
        scikit-learn. Problems of up to 256 samples are always solved to the precision of doubles, which
        costs little and makes the result independent of the order of the samples.
    nu : float, default=0.5
        In (0, 1]: upper bound on the fraction of samples outside, and lower bound on the fraction of
        support vectors.
    shrinking : bool, default=True
        Not used: the solver always works on active sets.
    cache_size : float, default=200
        Memory for kernel values in MiB, in addition to memory that grows with X alone.
    verbose : bool, default=False
        Print one line about each fit.
    max_iter : int, default=-1
        Maximum number of solver steps; -1: no limit.
    n_jobs : int or None, default=-1
        Number of threads of a fit, None for 1; -1: one per core. The result has the same bits for any number.

    Attributes
    ----------
    dual_coef_ : ndarray of shape (1, n_SV)
    fit_status_ : int
        0 if the fit reached `tol`, else 1, with a `ConvergenceWarning`.
    intercept_, offset_ : ndarray of shape (1,)
        decision_function = score_samples - offset_, and intercept_ = -offset_.
    n_features_in_ : int
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Only if X had column names.
    n_iter_ : int
        Number of solver steps, which differ from LIBSVM's.
    n_support_ : ndarray of shape (1,)
    shape_fit_ : tuple of int
    support_ : ndarray of shape (n_SV,)
        Indices of the support vectors.
    support_vectors_ : ndarray of shape (n_SV, n_features)
    fit_summary_ : FitSummary
        Result and cost of the fit.
    estimate_ : SupportEstimate
        The fitted estimate, in the scale in which the dual coefficients sum to 1.

    Notes
    -----
    C-contiguous float64 arrays are not converted, and decisions read them in place. Fits and
    decisions do not hold the interpreter's lock. Ctrl-C stops a fit.

    Examples
    --------
    >>> import dfr
    >>> X = [[0.0], [0.44], [0.45], [0.46], [1.0]]
    >>> dfr.OneClassSVM(gamma="auto").fit(X).predict(X)
    array([-1,  1,  1,  1, -1])
    """

    def __init__(
        self,
        *,
        kernel: str = "rbf",
        degree: int = 3,
        gamma: str | float = "scale",
        coef0: float = 0.0,
        tol: float = 1e-3,
        nu: float = 0.5,
        shrinking: bool = True,
        cache_size: float = 200,
        verbose: bool = False,
        max_iter: int = -1,
        n_jobs: int | None = -1,
    ) -> None:
        self.kernel = kernel
        self.degree = degree
        self.gamma = gamma
        self.coef0 = coef0
        self.tol = tol
        self.nu = nu
        self.shrinking = shrinking
        self.cache_size = cache_size
        self.verbose = verbose
        self.max_iter = max_iter
        self.n_jobs = n_jobs

    def fit(self, X: ArrayLike, y: Any = None, sample_weight: ArrayLike | None = None) -> OneClassSVM:
        """Estimate the support of the samples.

        Parameters
        ----------
        X : array_like of shape (n_samples, n_features)
            At least two samples.
        y : ignored
        sample_weight : array_like of shape (n_samples,), optional
            Weight of each sample, >= 0. Weighted fits are slower.

        Returns
        -------
        self : OneClassSVM

        Raises
        ------
        ValueError
            If a parameter or an entry of X is invalid; the message names it.
        """
        self._check_parameters()
        rows = check_rows(self, X, fitting=True)
        weights = check_weights(sample_weight, rows.shape[0])
        total = float(rows.shape[0] if weights is None else weights.sum())
        tolerance = float(self.tol)
        if rows.shape[0] <= _SMALL and total > 0.0:  # the fit rejects weights without a positive sum
            smallest = 1.0 if weights is None else float(weights[weights > 0.0].min())
            # The fit scales the tolerance if the sum of the coefficients is below 1.
            tolerance = min(tolerance, _ROUNDING * max(1.0, self.nu * total, smallest))
        # In addition to the kernel values, the solver keeps two reordered copies of X and some vectors.
        fixed_mib = rows.shape[0] * (16 * (rows.shape[1] + 1) + 128) / 2**20 + 1
        gamma = self._gamma_of(rows)
        estimate, summary = _core.SupportEstimate.fit(
            rows,
            nu=self.nu,
            gamma=gamma,
            tolerance=tolerance,
            max_iterations=max(self.max_iter, 0),
            memory_mib=self.cache_size + fixed_mib,
            weights=weights,
            threads=1 if self.n_jobs is None else max(self.n_jobs, 0),
        )

        self._gamma = gamma
        store_features(self, X, rows.shape[1])
        self.estimate_ = estimate
        self.fit_summary_ = summary
        self.support_ = np.flatnonzero(summary.alpha).astype(np.int32)
        self.offset_ = np.array([estimate.rho * estimate.libsvm_scale])
        self.n_iter_ = summary.iterations
        self.shape_fit_ = rows.shape
        self.fit_status_ = 0 if summary.kkt_gap < self.tol else 1
        if self.fit_status_ != 0:
            warnings.warn(
                f"The fit ended ({summary.reason}) after {summary.iterations} steps with violations of "
                f"{summary.kkt_gap:.2g}, above tol={self.tol}. Scale the data, raise tol or max_iter.",
                ConvergenceWarning,
                stacklevel=2,
            )
        if self.verbose:
            print(
                f"[dfr] {summary.reason} after {summary.iterations} steps in {summary.seconds:.3g} s: "
                f"{len(self.support_)} of {rows.shape[0]} samples are support vectors, "
                f"violations below {summary.kkt_gap:.2g}"
            )
        return self

    def decision_function(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the signed distance to the boundary in kernel space, positive inside.

        Parameters
        ----------
        X : array_like of shape (n_samples, n_features)

        Returns
        -------
        ndarray of shape (n_samples,)
            Values below their accuracy, 1e-12 of `offset_`, are 0: the boundary counts as inside.
        """
        self._check_fitted()
        return self.estimate_.decision(check_rows(self, X, fitting=False), libsvm_scale=True)

    def score_samples(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the sum of the kernels at each row of X: decision_function + offset_."""
        scores = self.decision_function(X)
        scores += self.offset_
        return scores

    def predict(self, X: ArrayLike) -> NDArray[np.intp]:
        """Return 1 for each row of X that is inside and -1 for each that is outside."""
        return np.where(self.decision_function(X) >= 0.0, np.intp(1), np.intp(-1))

    def export_onnx(self, path: str | PathLike[str]) -> None:
        """Write `decision_function` as an ONNX file in double.

        The input is x (rows, n_features_in_), the output g (rows).
        """
        self._check_fitted()
        self.estimate_.export_onnx(path, libsvm_scale=True)

    @property
    def dual_coef_(self) -> NDArray[np.float64]:
        return (self._fitted().alpha * self._fitted().libsvm_scale).reshape(1, -1)

    @property
    def intercept_(self) -> NDArray[np.float64]:
        self._fitted()
        return -self.offset_

    @property
    def n_support_(self) -> NDArray[np.int32]:
        return np.array([len(self._fitted().alpha)], dtype=np.int32)

    @property
    def support_vectors_(self) -> NDArray[np.float64]:
        return self._fitted().support_vectors

    def _fitted(self) -> _core.SupportEstimate:
        # Raises AttributeError before the fit, as hasattr() expects.
        if "estimate_" not in self.__dict__:
            raise AttributeError(f"This {type(self).__name__} instance is not fitted yet.")
        return self.estimate_

    def _check_fitted(self) -> None:
        if "estimate_" not in self.__dict__:
            raise NotFittedError(
                f"This {type(self).__name__} instance is not fitted yet. Call 'fit' with appropriate "
                "arguments before using this estimator."
            )

    def _check_parameters(self) -> None:
        if self.kernel != "rbf":
            raise ValueError(
                f"dfr.OneClassSVM supports only the kernel 'rbf', not {self.kernel!r}. "
                "sklearn.svm.OneClassSVM supports others."
            )
        if isinstance(self.gamma, str):
            if self.gamma not in ("scale", "auto"):
                raise ValueError(f"gamma must be 'scale', 'auto' or a positive number, not {self.gamma!r}")
        elif not isinstance(self.gamma, Real) or not 0.0 < self.gamma < np.inf:
            raise ValueError(f"gamma must be 'scale', 'auto' or a positive number, not {self.gamma!r}")
        if not isinstance(self.nu, Real) or not 0.0 < self.nu <= 1.0:
            raise ValueError(f"nu must lie in (0, 1], not {self.nu!r}")
        if not isinstance(self.tol, Real) or not 0.0 < self.tol < np.inf:
            raise ValueError(f"tol must be a positive number, not {self.tol!r}")
        if not isinstance(self.cache_size, Real) or not 0.0 < self.cache_size < np.inf:
            raise ValueError(f"cache_size must be a positive number, not {self.cache_size!r}")
        if not isinstance(self.max_iter, Integral) or self.max_iter < -1:
            raise ValueError(f"max_iter must be -1 or a number of steps, not {self.max_iter!r}")
        jobs = 1 if self.n_jobs is None else self.n_jobs
        if not isinstance(jobs, Integral) or not -1 <= jobs < 2**31 or jobs == 0:
            raise ValueError(
                f"n_jobs must be -1 (one per core), None or a number from 1 to 2^31 - 1, not {self.n_jobs!r}"
            )

    def _gamma_of(self, rows: NDArray[np.float64]) -> float:
        if self.gamma == "scale":
            variance = _core.variance(rows)
            if not np.isfinite(variance):
                raise ValueError("gamma='scale' needs the variance of X, which overflows: scale X")
            return 1.0 / (rows.shape[1] * variance) if variance != 0.0 else 1.0
        if self.gamma == "auto":
            return 1.0 / rows.shape[1]
        return float(self.gamma)


