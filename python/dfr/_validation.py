"""Base classes and checks of scikit-learn's estimators, with replacements for use without it."""

from __future__ import annotations

import inspect
import warnings
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dfr import _core

try:
    from sklearn.base import BaseEstimator, OutlierMixin
    from sklearn.exceptions import ConvergenceWarning, NotFittedError
except ImportError:

    class NotFittedError(ValueError, AttributeError):
        """Use of an estimator before fit."""

    class ConvergenceWarning(UserWarning):
        """A fit that did not reach its tolerance."""

    class BaseEstimator:
        """Implements get_params and set_params from the constructor's signature."""

        @classmethod
        def _get_param_names(cls) -> list[str]:
            parameters = inspect.signature(cls.__init__).parameters
            return sorted(name for name in parameters if name != "self")

        def get_params(self, deep: bool = True) -> dict[str, Any]:
            """Return the constructor's parameters by name."""
            return {name: getattr(self, name) for name in self._get_param_names()}

        def set_params(self, **params: Any) -> BaseEstimator:
            """Change parameters of the constructor."""
            known = self._get_param_names()
            for name, value in params.items():
                if name not in known:
                    raise ValueError(
                        f"Invalid parameter {name!r} for estimator {self}. Valid parameters are: {known}."
                    )
                setattr(self, name, value)
            return self

        def __repr__(self) -> str:
            defaults = inspect.signature(type(self).__init__).parameters
            changed = (
                f"{name}={value!r}"
                for name, value in self.get_params().items()
                if value is not defaults[name].default
            )
            return f"{type(self).__name__}({', '.join(changed)})"

    class OutlierMixin:
        """Implements fit_predict."""

        _estimator_type = "outlier_detector"

        def fit_predict(self, X: ArrayLike, y: Any = None) -> NDArray[np.intp]:
            """Fit to X and return 1 for rows inside and -1 for rows outside."""
            return self.fit(X).predict(X)


def _feature_names(X: Any) -> NDArray[np.object_] | None:
    columns = getattr(X, "columns", None)
    if columns is None or not all(isinstance(name, str) for name in columns):
        return None
    return np.asarray(columns, dtype=object)


def check_rows(estimator: Any, X: ArrayLike, fitting: bool) -> NDArray[np.float64]:
    """Return X as C-contiguous float64, without a copy if possible.

    Check X as scikit-learn does, with the same messages.
    """
    name = type(estimator).__name__
    if hasattr(X, "toarray"):
        raise TypeError(
            f"A sparse matrix was passed, but {name} needs dense data. Use X.toarray() to convert it."
        )
    if np.ma.is_masked(X):
        raise ValueError("X has masked entries: fill or drop them.")
    names = _feature_names(X)
    rows = np.asarray(X)
    if np.iscomplexobj(rows):
        raise ValueError(f"Complex data not supported\n{rows}\n")
    rows = np.asarray(rows, dtype=np.float64, order="C")
    if rows.ndim != 2:
        raise ValueError(
            f"Expected 2D array, got {rows.ndim}D array instead:\narray={rows}.\n"
            "Reshape your data either using array.reshape(-1, 1) if your data has a single feature "
            "or array.reshape(1, -1) if it contains a single sample."
        )
    least = 2 if fitting else 1
    if rows.shape[0] < least:
        raise ValueError(
            f"Found array with n_samples={rows.shape[0]} (shape={rows.shape}) while a minimum of "
            f"{least} is required by {name}."
        )
    if rows.shape[1] < 1:
        raise ValueError(
            f"Found array with 0 feature(s) (shape={rows.shape}) while a minimum of 1 is required by {name}."
        )
    bad = _core.find_non_finite(rows)
    if bad is not None:
        what = "NaN" if np.isnan(rows[bad]) else "infinity"
        raise ValueError(f"Input X contains {what}: row {bad[0]}, column {bad[1]}. {name} needs finite data.")

    if fitting:
        return rows
    if rows.shape[1] != estimator.n_features_in_:
        raise ValueError(
            f"X has {rows.shape[1]} features, but {name} is expecting {estimator.n_features_in_} features as input."
        )
    fitted_names = getattr(estimator, "feature_names_in_", None)
    if names is not None and fitted_names is None:
        warnings.warn(f"X has feature names, but {name} was fitted without feature names", stacklevel=3)
    elif names is None and fitted_names is not None:
        warnings.warn(
            f"X does not have valid feature names, but {name} was fitted with feature names", stacklevel=3
        )
    elif names is not None and not np.array_equal(names, fitted_names):
        raise ValueError(
            f"The feature names should match those that were passed during fit: {list(fitted_names)}, "
            f"not {list(names)}."
        )
    return rows


def store_features(estimator: Any, X: ArrayLike, size: int) -> None:
    """Store the number and the names of the features of X in a fitted estimator."""
    estimator.n_features_in_ = size
    names = _feature_names(X)
    if names is not None:
        estimator.feature_names_in_ = names
    elif hasattr(estimator, "feature_names_in_"):
        del estimator.feature_names_in_


def check_weights(sample_weight: ArrayLike | None, n_samples: int) -> NDArray[np.float64] | None:
    """Return the weights as a float64 array after checking their number."""
    if sample_weight is None:
        return None
    if np.ma.is_masked(sample_weight):
        raise ValueError("sample_weight has masked entries: fill or drop them.")
    weights = np.asarray(sample_weight, dtype=np.float64, order="C")
    if weights.ndim != 1:
        raise ValueError(f"Sample weights must be 1D array or list, not {weights.ndim}D")
    if weights.shape != (n_samples,):
        raise ValueError(f"sample_weight.shape == {weights.shape}, expected {(n_samples,)}!")
    return weights
