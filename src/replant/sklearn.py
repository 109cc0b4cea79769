"""TransferFunctionRegressor: replant as an estimator of scikit-learn, for its pipelines, searches and scores.

Needs scikit-learn: ``pip install 'replant[sklearn]'``.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from typing import Any, Self

import numpy as np
from numpy.exceptions import ComplexWarning

from replant.errors import ArgumentTypeError, InvalidArgumentError, MissingDependencyError, shown
from replant.fitting.fit import METHODS, fit
from replant.fitting.miso_fit import structures_of
from replant.fitting.miso_model import RowModel
from replant.model.preprocess import Preprocess
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray, iterable, one_of, whole
from replant.numerics.limits import duration
from replant.numerics.linear_algebra import quiet
from replant.online.identifier import Identifier
from replant.online.miso_identifier import RowIdentifier
from replant.verdict import fit_percent, simulate

try:
    from sklearn.base import BaseEstimator, RegressorMixin
    from sklearn.metrics import r2_score
    from sklearn.utils.validation import check_is_fitted, validate_data
except ImportError as cause:
    raise MissingDependencyError("replant.sklearn needs scikit-learn: pip install 'replant[sklearn]'") from cause

RECENT = 10_000  # samples that `partial_fit` keeps; they give the output's working point [samples]


class TransferFunctionRegressor(RegressorMixin, BaseEstimator):
    r"""A continuous-time transfer function as a regressor: X is the sampled input, y the output, rows in time order.

    .. math:: \hat y(t) = y_0 + \sum_i G_i(s) \, (u_i(t) - u_{0,i})

    ``fit`` uses the whole record (`replant.fit`); ``partial_fit`` continues with the next rows (`replant.Identifier`).
    A dynamic system has a memory, so rows must not be shuffled.  A prediction starts from rest at the working point, so
    its first rows lack the response to earlier inputs.  Cross-validate with splits that keep the order
    (`sklearn.model_selection.TimeSeriesSplit`).

    Parameters
    ----------
    poles, zeros : int or tuple of int
        For several inputs, ``poles`` has one entry for each column of X.
    delay : float or tuple of float
        Dead time in s.
    dt : float
        Sampling time in s: give it.  Scikit-learn asks for a default of each parameter; that of 1 counts time in rows,
        so that poles come in radians per row, and ``delay`` is a number of rows.
    method : {"auto", "srivc", "least_squares"}
        Method of ``fit`` with one input, see `replant.fit`.
    column : int, optional
        Column of X that is the only input.  None: every column of X is an input.

    Attributes
    ----------
    transfer_function_ : TransferFunction
        G(s), for one input only.
    transfer_functions_ : tuple of TransferFunction
        G(s) of each input.
    parameters_ : (P,) array
        Coefficients in the order of ``Structure.names``, one input after the other.
    std_ : (P,) array
        Standard deviations of the coefficients; NaN if unknown.
    input_offset_, output_offset_ : float
        The working point u_0, y_0; for several inputs u_0 is an array (q,).  After ``partial_fit``, y_0 comes from the
        last 10000 rows.
    n_features_in_ : int
    feature_names_in_ : array
        Only if the columns of X have names.

    Examples
    --------
    >>> u = np.where(np.arange(400) // 50 % 2 == 0, 1.0, -1.0)[:, None]
    >>> y = 7.0 + TransferFunction([2.0], [1.0, 0.5]).simulate(u[:, 0], dt=0.1)
    >>> model = TransferFunctionRegressor(poles=1, dt=0.1).fit(u, y)
    >>> print(model.transfer_function_)
    2 / (s + 0.5)
    >>> round(model.score(u, y), 3)
    1.0
    """

    def __init__(
        self,
        poles: int | tuple[int, ...] = 1,
        zeros: int | tuple[int, ...] = 0,
        delay: float | tuple[float, ...] = 0.0,
        dt: float = 1.0,
        method: str = "auto",
        column: int | None = None,
    ) -> None:
        self.poles = poles
        self.zeros = zeros
        self.delay = delay
        self.dt = dt
        self.method = method
        self.column = column

    def fit(self, X: Any, y: Any) -> Self:
        """Fit the whole record, rows in the order of time; earlier results are dropped.

        Parameters
        ----------
        X : (K, q) array
            One column for each input; with ``column``, that column is the only input.
        y : (K,) array
            Output.

        Raises
        ------
        InvalidArgumentError
            If the record is too short, or a parameter of the constructor cannot be used.
        """
        structures, dt, method = self._settings()
        u, y = self._checked_record(X, y, sum(each.size for each in structures) + 1, reset=True)
        self._identifier: Any = None
        if self._has_row:
            return self._use_row(fit(u, y, dt, **_orders(structures)).model)
        (structure,) = structures
        found = fit(u, y, dt, structure, method=method, preprocess=Preprocess("identity", "mean", "mean"))
        std = np.full(structure.size, np.nan) if found.uncertainty is None else found.uncertainty.std
        rest = float(found.preprocess.input_offset), found.simulation.offset
        return self._use((found.transfer_function,), found.parameters, std, rest)

    def partial_fit(self, X: Any, y: Any) -> Self:
        """Continue online with the next rows; the first call, and one after ``fit`` or new parameters, starts anew.

        Memory does not grow with the stream.  During the identifier's start-up, the model is fitted to the samples that
        the start-up holds.  Pass rows in chunks: each call costs some milliseconds in addition to its rows.

        Parameters
        ----------
        X : (K, q) array
            One column for each input; with ``column``, that column is the only input.
        y : (K,) array
            Output.
        """
        structures, dt, _ = self._settings()
        ident: Any = getattr(self, "_identifier", None)
        known: Any = ident.structures if isinstance(ident, RowIdentifier) else (getattr(ident, "structure", None),)
        if ident is None or (known, ident.dt) != (structures, dt):
            u, y = self._checked_record(X, y, 1, reset=True)
            if self._has_row:
                ident = RowIdentifier(dt=dt, **_orders(structures))
            else:
                ident = Identifier(structures[0], dt, preprocess=Preprocess("identity", "mean", "mean"))
            self._identifier, self._recent = ident, np.empty((0, 2))
        else:
            u, y = self._checked_record(X, y, 1, reset=False)
        ident.update_many(u, y)
        if not self._has_row:
            self._recent = np.concatenate([self._recent, np.column_stack([u, y])])[-RECENT:]
        return self._adopt(ident)

    @quiet
    def _adopt(self, ident: Identifier | RowIdentifier) -> Self:
        """Use the identifier's model; during its start-up, use the model that it would start with now."""
        if not (ident.has_model if isinstance(ident, RowIdentifier) else ident.settings):
            ident = ident.clone()
            ident.finish()
        if isinstance(ident, RowIdentifier):
            if ident.has_model:
                return self._use_row(ident.model)
            (u, y), std = ident.recent, np.full(ident.parameters.size, np.nan)  # the output's mean is the offset
            return self._use(ident.transfer_functions, ident.parameters, std, (u.mean(axis=0), float(y.mean())))
        u, y = self._recent.T
        input_offset = float(ident.settings.preprocess.input_offset) if ident.settings else float(u.mean())
        run = simulate(ident.transfer_function, u - input_offset, y, ident.dt)
        rest = input_offset, run.offset if np.isfinite(run.output).all() else float(y.mean())
        return self._use((ident.transfer_function,), ident.parameters, ident.uncertainty.std, rest)

    def _use_row(self, model: RowModel) -> Self:
        assert model.covariance is not None, "an estimate has a covariance"
        std = np.sqrt(np.diag(model.covariance))
        return self._use(model.transfer_functions, model.parameters, std, (model.input_levels, model.output_level))

    def _use(
        self, models: tuple[TransferFunction, ...], parameters: FloatArray, std: FloatArray, rest: tuple[Any, float]
    ) -> Self:
        """Set the attributes that scikit-learn users read; ``rest`` is the working point."""
        if not self._has_row:
            (self.transfer_function_,) = models
        self.transfer_functions_, self.parameters_, self.std_ = models, parameters, std
        self.input_offset_, self.output_offset_ = rest
        return self

    def predict(self, X: Any) -> FloatArray:
        """Return the output (K,) simulated from the input alone, from rest at the working point.

        Parameters
        ----------
        X : (K, q) array
            One column for each input, rows in the order of time.
        """
        check_is_fitted(self)
        u = self._input(_validated(self, X, dtype=np.float64, reset=False)) - self.input_offset_
        columns = [np.ascontiguousarray(each) for each in np.atleast_2d(u.T)]
        pairs = zip(self.transfer_functions_, columns, strict=True)
        return np.asarray(sum(g.simulate(each, self.dt) for g, each in pairs) + self.output_offset_)

    def fit_percent(self, X: Any, y: Any) -> float:
        r"""Return the simulated fit in percent, :math:`100 (1 - \|y - \hat y\| / \|y - \bar y\|)`.

        ``score`` is the coefficient of determination, :math:`1 - (1 - fit/100)^2`.
        """
        return fit_percent(y, self.predict(X))

    def score(self, X: Any, y: Any, sample_weight: Any = None) -> float:
        """Return the coefficient of determination of the simulated output.

        Parameters
        ----------
        X : (K, q) array
            One column for each input, rows in the order of time.
        y : (K,) array
            Output.
        sample_weight : (K,) array, optional
            Weights of the rows.

        Raises
        ------
        InvalidArgumentError
            If ``y`` or the weights cannot be used.
        """
        predicted = self.predict(X)
        with _in_one_line():
            return float(r2_score(y, predicted, sample_weight=sample_weight))

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True  # scikit-learn's test data are not a record of a dynamic system
        return tags

    @property
    def _has_row(self) -> bool:
        return iterable(self.poles)

    def _settings(self) -> tuple[tuple[Structure, ...], float, str]:
        """Return the checked arguments; scikit-learn requires the constructor to store them unchecked."""
        method = one_of("method", self.method, METHODS)
        if not self._has_row:
            given: tuple[Any, ...] = self.poles, self.zeros, self.delay
            return (Structure(*given),), duration("dt", self.dt), method
        if method != "auto" or self.column is not None:
            name = "column" if method == "auto" else "method"
            raise InvalidArgumentError(f"several inputs take no {name}: leave it out")
        poles: Any = self.poles
        return structures_of(len(poles), poles, self.zeros, self.delay), duration("dt", self.dt), method

    def _checked_record(self, X: Any, y: Any, least: int, *, reset: bool) -> tuple[FloatArray, FloatArray]:
        """Return input and output, checked as scikit-learn checks them."""
        X, y = _validated(self, X, y, reset=reset, dtype=np.float64, y_numeric=True, ensure_min_samples=least)
        return self._input(X), np.asarray(y, np.float64)

    def _input(self, X: FloatArray) -> FloatArray:
        if self._has_row:
            poles: Any = self.poles
            if X.shape[1] != len(poles):
                raise InvalidArgumentError(f"X must have a column for each of {len(poles)} inputs, got {X.shape[1]}")
            return np.ascontiguousarray(X)
        if self.column is None:
            if X.shape[1] != 1:
                several = (self.poles,) * X.shape[1]
                raise InvalidArgumentError(
                    f"X must have one column, the input, got {X.shape[1]}: choose one with column=, or give the number "
                    f"of poles of each, poles={several}"
                )
            return np.ascontiguousarray(X[:, 0])
        column = whole("column", self.column, 0)
        if column >= X.shape[1]:
            raise InvalidArgumentError(f"X has {X.shape[1]} columns, numbered from 0, and no column {shown(column)}")
        return np.ascontiguousarray(X[:, column])


def _orders(structures: tuple[Structure, ...]) -> dict[str, Any]:
    """Return poles, zeros and dead times of several inputs, one entry for each input."""
    return {name: tuple(getattr(each, name) for each in structures) for name in ("poles", "zeros", "delay")}


@contextlib.contextmanager
def _in_one_line() -> Iterator[None]:
    """Turn scikit-learn's error about an argument into a one-line error of this package."""
    try:
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            yield
    except TypeError as error:
        raise ArgumentTypeError(f"X or y: {error}") from error
    except (ValueError, OverflowError) as error:
        raise InvalidArgumentError(f"X or y: {error}") from error


def _validated(estimator: Any, *arrays: Any, **how: Any) -> Any:
    """Return X and y as validated by scikit-learn."""
    with _in_one_line(), warnings.catch_warnings():
        warnings.simplefilter("error", ComplexWarning)
        try:
            return validate_data(estimator, *arrays, **how)
        except ComplexWarning as warning:
            raise ValueError(f"complex data not supported: {warning}") from warning
